"""Two kinds of views take turns where those of one bring nothing more."""

from __future__ import annotations

import pytest

from infomap_ros.exploration.progress import MapProgress
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.unproductive_views import StrategyAlternator


def turns_after(known: list[float], limit: int) -> list[bool]:
    """Whose turn it is after each view, by the share that is known then."""
    turns, found = StrategyAlternator(TaskConfig(unproductive_views=limit, min_gain=0.01)), []
    for views, share in enumerate(known, start=1):
        turns.note(views, MapProgress(share, 0.0, 0.01, 100, 1000, share))
        found.append(turns.is_other)
    return found


def test_the_other_kind_has_its_turn_after_half_the_limit() -> None:
    assert turns_after([0.5] * 9, limit=6) == [False] * 3 + [True] * 3 + [False] * 3


def test_views_that_bring_something_keep_their_turn() -> None:
    known = [0.5, 0.5, 0.5, 0.5, 0.52, 0.54, 0.56, 0.58, 0.58, 0.58]
    assert turns_after(known, limit=6) == [False] * 3 + [True] * 7


def test_no_view_between_two_choices_is_no_view_in_vain() -> None:
    turns = StrategyAlternator(TaskConfig(unproductive_views=6))
    for _ in range(10):
        turns.note(4, MapProgress(0.5, 0.0, 0.01, 100, 1000, 0.5))
    assert not turns.is_other


@pytest.mark.parametrize("limit", [1, 2, 3])
def test_one_view_is_the_least_limit(limit: int) -> None:
    assert turns_after([0.5] * 4, limit) == [False, True, False, True]
