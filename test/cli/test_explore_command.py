"""`infomap explore` ends in order when it is interrupted, and finds strategies beside the user."""

from __future__ import annotations

import io
import signal

import pytest
from rich.console import Console

from infomap_ros.cli.explore_command import _stops_when_interrupted
from infomap_ros.cli.study_options import check_strategy
from infomap_ros.errors import ConfigError
from infomap_ros.exploration.control import Control, Request


def test_an_interrupt_asks_the_run_to_stop_and_a_second_one_leaves():
    control, said = Control(), io.StringIO()
    before = signal.getsignal(signal.SIGINT)
    with _stops_when_interrupted(control, Console(file=said)):
        signal.raise_signal(signal.SIGINT)
        assert control.request is Request.STOP
        assert "map and report follow" in said.getvalue()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_a_strategy_in_the_current_folder_is_found(tmp_path, monkeypatch):
    source = "from infomap_ros.views.ranking.strategies import LargestInformation\n"
    source += "class Thrifty(LargestInformation): pass\n"
    (tmp_path / "my_thrifty_strategy.py").write_text(source)
    monkeypatch.chdir(tmp_path)
    check_strategy("my_thrifty_strategy.Thrifty")
    with pytest.raises(ConfigError, match=r"--strategy is 'my_thrifty_strategy\.Other'"):
        check_strategy("my_thrifty_strategy.Other")
