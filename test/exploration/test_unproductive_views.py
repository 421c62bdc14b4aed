"""An exploration ends where views bring nothing more."""

from __future__ import annotations

from infomap_ros.exploration.robot import MapProgress
from infomap_ros.exploration.rules import UnproductiveViews
from infomap_ros.exploration.task import TaskConfig


def test_ends_by_what_views_bring_in_their_time() -> None:
    """Half as much in a tenth of the time is more; a map that is put right takes nothing."""
    rule = UnproductiveViews(TaskConfig(unproductive_views=2, min_rate=0.02))
    seconds, left = 0.0, 10000.0
    ended = []
    brought = [(3000, 10), (3000, 10), (300, 1), (-200, 5), (60, 10), (40, 10), (10, 10)]
    for views, (bits, time) in enumerate([(0, 0), *brought], start=1):
        seconds, left = seconds + time, left - bits
        rule.note(views, seconds, MapProgress(0.5, left, 0.01, 100, 1000, 0.5))
        ended.append(bool(rule.reason()))
    assert ended == [False] * 5 + [True] * 3
    assert "brought 50 bits" in rule.reason() and "0.8 % of the best rate" in rule.reason()
