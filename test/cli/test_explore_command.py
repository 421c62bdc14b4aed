"""`infomap explore` finds strategies beside the user."""

from __future__ import annotations

import pytest

from infomap_ros.cli.study_options import check_strategy
from infomap_ros.errors import ConfigError


def test_a_strategy_in_the_current_folder_is_found(tmp_path, monkeypatch):
    source = "from infomap_ros.views.ranking.strategies import LargestInformation\n"
    source += "class Thrifty(LargestInformation): pass\n"
    (tmp_path / "my_thrifty_strategy.py").write_text(source)
    monkeypatch.chdir(tmp_path)
    check_strategy("my_thrifty_strategy.Thrifty")
    with pytest.raises(ConfigError, match=r"--strategy is 'my_thrifty_strategy\.Other'"):
        check_strategy("my_thrifty_strategy.Other")
