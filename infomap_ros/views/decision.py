"""A choice and its explanation, and what is asked of the robot for it: can a view be reached?"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from textwrap import shorten
from time import perf_counter
from typing import Protocol

import numpy as np

from infomap_ros.geometry.transforms import FloatArray


class ReachResult(Protocol):
    """How a view is reached, or why it is not.

    Attributes:
        reason: empty where it can be reached, else a short sentence.
        travel: length of the base's path [m].
        route: the motion itself, for whoever executes it; not looked into here.
        partial: the route ends at the farthest safe approach, not at the view.
        seconds: time that the motion takes [s]; NaN where that is not known.
    """

    @property
    def reason(self) -> str: ...  # noqa: D102
    @property
    def travel(self) -> float: ...  # noqa: D102
    @property
    def route(self) -> object | None: ...  # noqa: D102
    @property
    def partial(self) -> bool: ...  # noqa: D102
    @property
    def seconds(self) -> float: ...  # noqa: D102


class Reachability(Protocol):
    """A robot that can be asked which views it reaches."""

    def may_reach(self, poses: FloatArray) -> Sequence[str]:
        """Cheap test of many views, ``T_map_camera`` (M, 4, 4): "" or the reason against each."""

    def reach(self, T_map_camera: FloatArray) -> ReachResult:
        """Plan the motion to one view, shape (4, 4)."""


@dataclass(frozen=True, eq=False)
class RatedView:
    """A candidate with what is known of it.

    Attributes:
        pose: ``T_map_camera``, shape (4, 4).
        terms: value of each term of the rating in its own unit; empty where a cheap test had
            already ruled the view out.
        rating: RF of eq. (11) [full views]; NaN where not rated.
        score: by which the strategy ranked it; NaN where not ranked.
        rejection: why it cannot be chosen; empty where nothing speaks against it.
        fine: whether its information is exact, not that of the first ranking.
    """

    pose: FloatArray
    terms: dict[str, float] = field(default_factory=dict)
    rating: float = float("nan")
    score: float = float("nan")
    rejection: str = ""
    fine: bool = False

    def rejected(self, reason: str) -> RatedView:
        """The same view with a reason against it."""
        return replace(self, rejection=reason)


@dataclass(frozen=True, eq=False)
class ViewDecision:
    """The chosen view, all others, and why.

    Attributes:
        chosen: the next view; None where there is none.
        reach: how it is reached; None where nothing is chosen.
        candidates: all views that were considered, the chosen one included.
        reason: why this one, or why none, in words.
        seconds: time spent by stage [s].
        plan: views that are meant to follow, shape (K, 4, 4); empty for strategies that look one
            view ahead.
        strategy: name of the strategy.
    """

    chosen: RatedView | None
    reach: ReachResult | None
    candidates: tuple[RatedView, ...]
    reason: str
    seconds: dict[str, float]
    plan: FloatArray = field(default_factory=lambda: np.empty((0, 4, 4)))
    strategy: str = ""

    def rejections(self) -> Counter[str]:
        """How many views were rejected for each reason; see `count_reasons`."""
        return count_reasons((view.rejection, 1) for view in self.candidates if view.rejection)


def count_reasons(reasons: Iterable[tuple[str, int]]) -> Counter[str]:
    """How often there was each of some reasons, told with how often each time.

    Reasons that differ in nothing but numbers count as one, by the text of the first.
    """
    counts: Counter[str] = Counter()
    first: dict[str, str] = {}
    for reason, count in reasons:
        kind = re.sub(r"[-+]?\d[\d.]*", "#", reason)
        counts[first.setdefault(kind, reason)] += count
    return counts


class Stopwatch:
    """Time spent by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time inside the block to a stage."""
        start = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + perf_counter() - start


def why_this(
    chosen: RatedView, views: list[RatedView], kept: bool, full_view: float, unit: str
) -> str:
    """Say what speaks for the chosen view and against those that were ranked before it.

    It is short, as people read it while the robot moves: all terms and all rejections are in the
    explanation beside it.

    Args:
        chosen: the view.
        views: all that were considered.
        kept: it is the previous goal.
        full_view: information of a view into nothing but unknown space; 0 where that has none.
        unit: of the information.
    """
    (x, y, z), terms = chosen.pose[:3, 3], chosen.terms
    information = terms.get("information", 0.0)
    parts = [f"{information:.{0 if abs(information) >= 100.0 else 2}f} {unit}"]
    if full_view > 0.0:
        parts.append(f"{100.0 * information / full_view:.0f} % of a full view")
    parts.append(_cost_of(terms))
    view = "still the view" if kept else "view"
    text = f"{view} from ({x:.1f}, {y:.1f}, {z:.1f}) m: {', '.join(parts)}"
    better = sum(bool(view.rejection) and view.score > chosen.score for view in views)
    return text + (f"; {better} better ruled out" if better else "")


def _cost_of(terms: Mapping[str, float]) -> str:
    """What a view costs, in the unit in which that was rated."""
    if "duration" in terms:
        return f"{terms['duration']:.1f} s away"
    return f"{terms.get('distance', 0.0):.2f} m with turns"


def why_none(views: list[RatedView]) -> str:
    """Say why no view is chosen."""
    if not views:
        return "no candidate view: the camera is in no known free space"
    counts = count_reasons((view.rejection, 1) for view in views if view.rejection)
    told = (
        f"{shorten(why.split(';')[0], _LETTERS, placeholder=' ...')} ({count})"
        for why, count in counts.most_common(5)
    )
    return f"no view can be chosen: {counts.total()} ruled out, most: {', '.join(told)}."


_LETTERS = 70
"""Of a reason against views; its first clause is told."""
