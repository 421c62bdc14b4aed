"""Frontiers of a planar map: free cells beside unknown ones, in groups.

The nearest frontier.

B. Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997,
doi:10.1109/CIRA.1997.613851.

Views that a strategy proposed, found again among the options.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE, UNKNOWN
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.sampling.orientations import look_rotations
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation

_EIGHT = np.ones((3, 3), np.bool_)


@dataclass(frozen=True, eq=False)
class Frontier:
    """One group of frontier cells.

    Attributes:
        places: centers of its cells, shape (n, 3) [m, map].
    """

    places: FloatArray

    @property
    def middle(self) -> FloatArray:
        """Mean of its cells, shape (3,) [m, map]."""
        return np.asarray(self.places.mean(axis=0))

    @property
    def center(self) -> FloatArray:
        """The cell nearest to the mean, shape (3,) [m, map]."""
        gaps = np.linalg.norm(self.places - self.middle, axis=1)
        return np.asarray(self.places[gaps.argmin()])


def frontier_cells(situation: Situation, surroundings: Surroundings) -> NDArray[np.bool_]:
    """Free cells that can be reached and have an unknown neighbor over an edge.

    Of the camera's layer of the window, shape (nx, ny).
    """
    window, states = surroundings.window, surroundings.states
    layer = int(window.positions_of(situation.position[None])[0, 2])
    plane = np.pad(states[:, :, layer], 1, constant_values=UNKNOWN)
    region = situation.region
    edges = window.centers_of(np.column_stack([np.arange(max(states.shape))] * 3))
    unknown = plane == UNKNOWN
    for axis in (0, 1):
        outside = (edges[: states.shape[axis], axis] < region.low[axis]) | (
            edges[: states.shape[axis], axis] > region.high[axis]
        )
        outside = np.concatenate([[False], outside, [False]])
        unknown &= ~(outside[:, None] if axis == 0 else outside)
    near = ndimage.binary_dilation(unknown)[1:-1, 1:-1]
    reached = np.zeros(states.shape[:2], np.bool_)
    box, first = surroundings.reached, surroundings.first
    depth = layer - first[2]
    part = (slice(first[0], first[0] + box.shape[0]), slice(first[1], first[1] + box.shape[1]))
    reached[part] = box[:, :, depth]
    return np.asarray(near & reached & (states[:, :, layer] == FREE))


def find_frontiers(
    situation: Situation, surroundings: Surroundings, least: int = 3, largest: float = np.inf
) -> list[Frontier]:
    """Groups of frontier cells that touch each other, also at corners.

    Args:
        situation: a planar task.
        surroundings: its known space.
        least: groups of fewer cells are left out, unless all are.
        largest: a group is halved along its principal axis until none extends farther than this
            from its mean [m].
    """
    cells = frontier_cells(situation, surroundings)
    labels, count = ndimage.label(cells, _EIGHT)
    layer = surroundings.window.positions_of(situation.position[None])[0, 2]
    found: list[Frontier] = []
    order = np.argsort(labels[cells], kind="stable")
    places = np.argwhere(cells)[order]
    splits = np.cumsum(np.bincount(labels[cells], minlength=count + 1)[1:])[:-1]
    for part in np.split(places, splits) if len(places) else []:
        index = np.column_stack([part, np.full(len(part), layer)])
        found += _halved(surroundings.window.centers_of(index), largest)
    kept = [frontier for frontier in found if len(frontier.places) >= least]
    return kept or found


def _halved(places: FloatArray, largest: float) -> list[Frontier]:
    offsets = places - places.mean(axis=0)
    if len(places) < 2 or np.linalg.norm(offsets, axis=1).max() <= largest:
        return [Frontier(places)]
    along = offsets @ np.linalg.svd(offsets, full_matrices=False)[2][0]
    halves = places[along <= 0.0], places[along > 0.0]
    return [part for half in halves for part in _halved(half, largest)]


def level_views(places: FloatArray, azimuths: FloatArray) -> FloatArray:
    """``T_map_camera`` of level views, places (N, 3) [m, map] and azimuths (N,) -> (N, 4, 4)."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, :3, :3] = look_rotations(azimuths, np.zeros(len(places)))
    poses[:, :3, 3] = places
    return poses


def turned_views(places: FloatArray, turns: int) -> FloatArray:
    """Views all around from places, (N, 3) [m, map] -> (N * turns, 4, 4), place by place."""
    azimuths = np.tile(2.0 * np.pi * np.arange(turns) / turns - np.pi, len(places))
    return level_views(np.repeat(places, turns, axis=0), azimuths)


_BELOW = -1e9  # of views that a strategy did not propose
_SAME_TURN = 0.05  # [rad]


def places_of(options: Options, poses: FloatArray) -> NDArray[np.int64]:
    """Which option each pose, shape (N, 4, 4), is; -1 for those that a test ruled out."""
    known = {
        pose.tobytes(): index for index, pose in enumerate(np.ascontiguousarray(options.poses))
    }
    rows = np.ascontiguousarray(poses, dtype=np.float64)
    return np.array([known.get(pose.tobytes(), -1) for pose in rows], np.int64)


def shares_of(options: Options, ratings: Ratings, places: NDArray[np.int64]) -> FloatArray:
    """What proposed views are expected to inform, shape (N,) [full views].

    0 for views that a test ruled out, and for views that were taken before: one look makes all in
    sight certain, so that what is still expected of them never comes.

    Args:
        options: all views.
        ratings: of these.
        places: of the proposed views, shape (N,), see `places_of`.
    """
    shares = np.where(places >= 0, ratings.shares[places], 0.0)
    poses, near = options.poses[places], 0.5 * options.surroundings.voxel_size
    for past in options.situation.past_views:
        same = np.linalg.norm(poses[:, :3, 3] - past[:3, 3], axis=1) < near
        same &= poses[:, :3, 2] @ past[:3, 2] > np.cos(_SAME_TURN)
        shares[same] = 0.0
    return np.asarray(shares)


def scores_of(
    options: Options, places: NDArray[np.int64], values: FloatArray, others: FloatArray
) -> FloatArray:
    """Scores of all options: values, (N,), of the proposed ones at `places`, (N,).

    Others come after all of these, by their values in `others`, shape (M,), for when nothing that
    was proposed can be chosen.
    """
    scores = _BELOW + np.clip(others, -1e6, 1e6)
    found = places >= 0
    scores[places[found]] = np.maximum(values[found], 0.5 * _BELOW)
    return scores


_TURNS = 12
_NOTHING = 0.002  # a view that informs less shows nothing of a frontier [full views]


class NearestFrontier:
    """Goes to the frontier with the shortest path to its center, and looks where most is unknown.

    The paper's robot looks all around when it has arrived. A sensor with a narrower field of view
    looks at what informs most, and again as long as a frontier is left there.
    """

    requires_positive_utility = False

    def __init__(self) -> None:
        self._proposed = np.empty((0, 4, 4))

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """The centers of all frontiers, with directions all around."""
        found = find_frontiers(situation, surroundings)
        places = np.array([frontier.center for frontier in found]).reshape(-1, 3)
        self._proposed = turned_views(places, _TURNS)
        return self._proposed

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Minus the distance to the frontier [m]; of directions at one place, by information.

        Views that inform nothing, or were taken in vain, come last.
        """
        places = places_of(options, self._proposed)
        shares = shares_of(options, ratings, places)
        lengths = np.where(shares > _NOTHING, options.path_lengths[places], np.inf)
        values = -np.where(np.isfinite(lengths), lengths, 1e6) + 1e-3 * shares
        return Scores(scores_of(options, places, values, ratings.ratings))
