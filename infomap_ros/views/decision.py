"""A choice and its explanation, and what is asked of the robot for it: can a view be reached?

Views that could not be reached, until the map around them changes.

Voxels that views promised to inform and did not.

A stereo camera measures surfaces, and frees the space before them. Where there is no surface within
its range, as in the sky, or none with texture, nothing comes back however often one looks, and the
unknown voxels there would call for another look for ever. What a view is still expected to tell
right after it has been taken is in vain: that is all it needs to know.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from textwrap import shorten
from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray, check_transform
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.keys import unpack_all
from infomap_ros.mapping.voxels.state import put_states, unknown_states
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA


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
    """How often there was each of some reasons, listed with how often each time.

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
    listed = (
        f"{shorten(why.split(';')[0], _LETTERS, placeholder=' ...')} ({count})"
        for why, count in counts.most_common(5)
    )
    return f"no view can be chosen: {counts.total()} ruled out, most: {', '.join(listed)}."


_LETTERS = 70
"""Of a reason against views; its first clause is listed."""


_SAME_DISTANCE, _SAME_ANGLE = 0.2, 0.35
# [m], [rad]: views nearer to a remembered one, and turned by less, are the same
_AROUND = 0.8  # [m] about a remembered view, where the map must change for it to be tried again
_LOCAL_CHANGE = 0.02  # share of the voxels there whose state must change for that
_OVERALL_CHANGE = 0.15
# share by which the number of known voxels must change for all to be tried again: the route may
# lead elsewhere


@dataclass(frozen=True, eq=False)
class _Goal:
    pose: FloatArray
    reason: str
    signs: np.ndarray[tuple[int, int, int], np.dtype[np.int8]]
    known_voxels: int


class GoalMemory:
    """Remembers unreachable views, so that they are not tried again and again."""

    def __init__(self) -> None:
        self._goals: list[_Goal] = []

    def __len__(self) -> int:
        return len(self._goals)

    def remember(self, T_map_camera: FloatArray, reason: str, voxel_map: VoxelMap) -> None:
        """Note that a view, shape (4, 4), cannot be reached in the map as it is, and why."""
        pose = check_transform(T_map_camera, "T_map_camera")
        signs = self._signs(pose, voxel_map)
        self._goals.append(_Goal(pose, reason, signs, voxel_map.known_voxels))

    def reasons_against(self, poses: FloatArray, voxel_map: VoxelMap) -> list[str]:
        """Why not to try views, shape (M, 4, 4), again: "" or the reason, one each.

        Goals around which the map has changed are forgotten first.
        """
        self._forget_changed(voxel_map)
        reasons = [""] * len(poses)
        least_cosine = float(np.cos(_SAME_ANGLE))
        for goal in self._goals:
            gaps = np.linalg.norm(poses[:, :3, 3] - goal.pose[:3, 3], axis=1)
            near = gaps <= _SAME_DISTANCE
            # trace(R^T Q) = 1 + 2 cos(angle between the rotations)
            traces = np.einsum("mij,ij->m", poses[:, :3, :3], goal.pose[:3, :3])
            for index in np.flatnonzero(near & (0.5 * (traces - 1.0) >= least_cosine)):
                reasons[index] = f"unreachable before: {goal.reason}"
        return reasons

    def _forget_changed(self, voxel_map: VoxelMap) -> None:
        if not self._goals:
            return
        known = voxel_map.known_voxels
        self._goals = [
            goal
            for goal in self._goals
            if abs(known - goal.known_voxels) <= _OVERALL_CHANGE * max(goal.known_voxels, 1)
            and self._share_changed(goal, voxel_map) <= _LOCAL_CHANGE
        ]

    def _share_changed(self, goal: _Goal, voxel_map: VoxelMap) -> float:
        return float(np.mean(self._signs(goal.pose, voxel_map) != goal.signs))

    def _signs(
        self, pose: FloatArray, voxel_map: VoxelMap
    ) -> np.ndarray[tuple[int, int, int], np.dtype[np.int8]]:
        """Unknown 0, rather empty -1, rather occupied 1, of the voxels around a view."""
        middle = pose[:3, 3]
        window = voxel_map.window(middle - _AROUND, middle + _AROUND)
        signs = np.where(window.quanta > 0, 1, -1).astype(np.int8)
        signs[window.quanta == UNKNOWN_QUANTA] = 0
        return signs


_CERTAINLY_FREE = -60  # [quanta]


LOOK_LIMIT = 1.5
"""A voxel that stays unknown is no longer expected to tell anything after so many looks in vain
from next to it. A look from a distance d counts 1 - (d / max_range)^2.
"""


class UnproductiveLooks:
    """How often each voxel was looked at in vain.

    Args:
        limit: so many of them give a voxel up, see `LOOK_LIMIT`.
    """

    def __init__(self, limit: float = LOOK_LIMIT) -> None:
        self._limit = limit
        self._keys: NDArray[np.int64] = np.zeros(0, np.int64)
        self._counts: FloatArray = np.zeros(0)

    def __len__(self) -> int:
        return len(self._keys)

    def note(
        self, keys: NDArray[np.int64], voxel_map: VoxelMap, position: FloatArray, max_range: float
    ) -> None:
        """Count a look.

        Args:
            keys: packed indices of the voxels that the view just taken is still expected to
                inform, each once, shape (K,).
            voxel_map: with that view.
            position: of the camera, shape (3,) [m, map].
            max_range: of the camera [m].
        """
        unknown = keys[~_known(voxel_map, keys)]
        centers = (unpack_all(unknown) + 0.5) * voxel_map.config.voxel_size
        nearness = np.linalg.norm(centers - position, axis=1) / max_range
        weights = np.maximum(1.0 - nearness**2, 0.0)
        still = ~_known(voxel_map, self._keys)
        keys = np.concatenate([self._keys[still], unknown])
        self._keys, place = np.unique(keys, return_inverse=True)
        counts = np.concatenate([self._counts[still], weights])
        self._counts = np.bincount(place, counts, len(self._keys)).astype(np.float64)

    def are_given_up(self, keys: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether voxels are given up, by their packed indices, shape (K,)."""
        return np.isin(keys, self._keys[self._counts >= self._limit])

    def without_them(self, voxel_map: VoxelMap) -> VoxelMap:
        """A copy of the map in which the voxels that are given up count as free.

        For what views are expected to tell, and for nothing else: nobody has seen that they are.
        The map itself where none is given up.
        """
        given_up = self._keys[self._counts >= self._limit]
        given_up = given_up[~_known(voxel_map, given_up)]
        if not len(given_up):
            return voxel_map
        copy = VoxelMap.from_state(voxel_map.config, voxel_map.state())
        states = unknown_states(unpack_all(given_up).astype(np.int32))
        states.known[:] = True
        states.quanta[:] = _CERTAINLY_FREE
        put_states(copy._storage, states)
        return copy


def _known(voxel_map: VoxelMap, keys: NDArray[np.int64]) -> NDArray[np.bool_]:
    return voxel_map.is_known((unpack_all(keys) + 0.5) * voxel_map.config.voxel_size)


class GainPrior:
    """What share of what views could inform they have informed, in their order.

    A camera that looks into the sky, or at a wall closer than it can match, is told nothing, and
    the map goes on promising as much. What the map has gained by a view, against what the view
    still promises, says how far views of its kind are to be trusted; see
    `views.ranking.terms.Repetition`.

    Attributes:
        shares: of each view, 0 to 1; NaN where it is not known.
    """

    def __init__(self) -> None:
        self.shares: list[float] = []
        self._entropy = math.nan

    def note(self, left: Sequence[float], entropy: float) -> None:
        """Count views since the last call; of several it is not known which has informed what.

        Args:
            left: what each of them is still expected to tell, oldest first [bits]; NaN for one
                that was wanted, and the robot looked from beside it.
            entropy: of the region of the task with them [bits].
        """
        gained = max(self._entropy - entropy, 0.0)
        self._entropy = entropy
        taken = [each for each in left if not math.isnan(each)]
        known = len(taken) == 1 and gained + taken[0] > 0.0
        self.shares += [gained / (gained + each) if known else math.nan for each in left]
