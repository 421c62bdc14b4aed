"""A choice and its explanation."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from textwrap import shorten
from time import perf_counter

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.reach import ReachResult


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

    Args:
        chosen: the view.
        views: all that were considered.
        kept: it is the previous goal.
        full_view: information of a view into nothing but unknown space; 0 where that has none.
        unit: of the information.
    """
    (x, y, z), terms = chosen.pose[:3, 3], chosen.terms
    information = terms.get("information", 0.0)
    share = ""
    if full_view > 0.0:
        share = f" ({100.0 * information / full_view:.0f} % of a full unknown view)"
    parts = [
        f"view from ({x:.2f}, {y:.2f}, {z:.2f}) m: expects {information:.{_digits(information)}f} "
        f"{unit}{share} {_cost_of(terms)}"
    ]
    if kept:
        parts.append("the goal so far is kept, as no other is clearly better")
    changes = {name: terms.get(name, 0.0) for name in ("interest", "teammates", "repetition")}
    least = 0.005 * abs(information)
    parts += [
        f"{name} {change:+.{_digits(change)}f} {unit}"
        for name, change in changes.items()
        if abs(change) > least
    ]
    better = [view for view in views if view.rejection and view.score > chosen.score]
    text = "; ".join(parts)
    return f"{text}. {_count_reasons(better, 'ranked higher but ruled out')}".rstrip()


def _cost_of(terms: Mapping[str, float]) -> str:
    """What a view costs, in the unit in which that was rated."""
    if "duration" in terms:
        return f"after {terms['duration']:.1f} s"
    return f"at distance {terms.get('distance', 0.0):.2f}"


def _digits(value: float) -> int:
    """Digits behind the point that leave about three in all."""
    return 0 if abs(value) >= 100.0 or value == 0.0 else 2


def why_none(views: list[RatedView]) -> str:
    """Say why no view is chosen."""
    if not views:
        return "no candidate view: the camera is in no known free space"
    text = _count_reasons([view for view in views if view.rejection], "ruled out")
    return f"no view can be chosen: {text}".rstrip()


def _count_reasons(views: list[RatedView], what: str) -> str:
    if not views:
        return ""
    counts = count_reasons((view.rejection, 1) for view in views).most_common(5)
    listed = ", ".join(f"{shorten(why, 90, placeholder=' ...')} ({n})" for why, n in counts)
    return f"{len(views)} {what}: {listed}."
