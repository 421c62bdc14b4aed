"""Two kinds of views take turns where those of one bring nothing more."""

from __future__ import annotations

import pytest

from infomap_ros.exploration.progress import MapProgress
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.unproductive_views import StrategyAlternator, UnproductiveViews


def turns_after(known: list[float], limit: int) -> list[bool]:
    """Whose turn it is after each view, by the share that is known then."""
    turns, found = StrategyAlternator(TaskConfig(unproductive_views=limit)), []
    for views, share in enumerate(known, start=1):
        turns.note(views, MapProgress(share, 1000.0 * (1.0 - share), 0.01, 100, 1000, share))
        found.append(turns.is_other)
    return found


def test_the_other_kind_has_its_turn_after_half_the_limit() -> None:
    known = [0.2, *[0.5] * 10]
    assert turns_after(known, limit=6) == [False] * 4 + [True] * 3 + [False] * 3 + [True]


def test_views_that_bring_something_keep_their_turn() -> None:
    known = [0.2, 0.5, 0.5, 0.5, 0.5, 0.55, 0.6, 0.65, 0.7, 0.7, 0.7]
    assert turns_after(known, limit=6) == [False] * 4 + [True] * 7


def test_no_view_between_two_choices_is_no_view_in_vain() -> None:
    turns = StrategyAlternator(TaskConfig(unproductive_views=6))
    for _ in range(10):
        turns.note(4, MapProgress(0.5, 500.0, 0.01, 100, 1000, 0.5))
    assert not turns.is_other


@pytest.mark.parametrize("limit", [1, 2, 3])
def test_one_view_is_the_least_limit(limit: int) -> None:
    assert turns_after([0.2, *[0.5] * 4], limit) == [False, False, True, False, True]


def test_ends_by_what_views_tell_in_their_time() -> None:
    """Half as much in a tenth of the time is more; a map that is put right takes nothing."""
    rule, seconds, left = UnproductiveViews(TaskConfig(unproductive_views=2)), 0.0, 10000.0
    ended = []
    told = [(3000, 10), (3000, 10), (300, 1), (-200, 5), (60, 10), (40, 10), (10, 10)]
    for views, (bits, time) in enumerate([(0, 0), *told], start=1):
        seconds, left = seconds + time, left - bits
        rule.note(views, seconds, MapProgress(0.5, left, 0.01, 100, 1000, 0.5))
        ended.append(bool(rule.reason()))
    assert ended == [False] * 5 + [True] * 3
    assert "told 50 bits" in rule.reason() and "0.8 % of the best rate" in rule.reason()
