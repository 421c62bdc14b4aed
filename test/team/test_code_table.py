"""The table of a robot's codes."""

from __future__ import annotations

import pytest

from infomap_ros.errors import CapacityError
from infomap_ros.team.gaussian_code import empty_codes, with_code_room


def test_more_blocks_than_an_owner_can_number_are_refused():
    with pytest.raises(CapacityError, match="blocks"):
        with_code_room(empty_codes(), 1, 2**23 + 1)
