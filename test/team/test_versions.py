"""Versions begin again after the last, and the newer of two is known nevertheless."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infomap_ros.team.update import is_newer, next_version, version_at

LAST = 2**32 - 1
VERSIONS = st.integers(1, LAST)


def newer(version: int, other: int) -> bool:
    return bool(is_newer(np.uint32(version), np.uint32(other)))


def test_the_version_after_the_last_is_the_first() -> None:
    assert [next_version(v) for v in (1, 41, LAST - 1, LAST)] == [2, 42, LAST, 1]


@given(version=VERSIONS)
def test_the_next_version_is_newer_and_never_the_other_way_round(version: int) -> None:
    assert newer(next_version(version), version)
    assert not newer(version, next_version(version))


@given(version=VERSIONS)
def test_every_version_is_newer_than_none_and_not_newer_than_itself(version: int) -> None:
    assert newer(version, 0)
    assert not newer(version, version)


@given(version=VERSIONS, ahead=st.integers(1, 2**31 - 2))
def test_up_to_half_the_numbers_ahead_is_newer(version: int, ahead: int) -> None:
    later = (version - 1 + ahead) % LAST + 1

    assert newer(later, version)
    assert not newer(version, later)


@pytest.mark.parametrize("now", [0, 1_763_709_098_123_456_789, 2**63 - 1])
def test_a_later_start_begins_with_a_newer_version(now: int) -> None:
    one_second, a_year = 1_000_000_000, 365 * 86400 * 1_000_000_000
    start = version_at(now)

    assert 1 <= start <= LAST
    assert newer(version_at(now + one_second), start)
    assert newer(version_at(now + a_year), start)


def test_a_robot_that_publishes_ten_times_a_second_stays_behind_the_clock() -> None:
    start = version_at(1_763_709_098_000_000_000)
    version = start
    for _ in range(600):
        version = next_version(version)

    assert newer(version_at(1_763_709_158_000_000_000), version)
