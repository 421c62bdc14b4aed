"""Views that a strategy proposed, found again among the options."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings

_BELOW = -1e9  # of views that a strategy did not propose
_SAME_TURN = 0.05  # [rad]


def places_of(options: Options, poses: FloatArray) -> NDArray[np.int64]:
    """Which option each pose, shape (N, 4, 4), is; -1 for those that a test ruled out."""
    known = {
        pose.tobytes(): index for index, pose in enumerate(np.ascontiguousarray(options.poses))
    }
    rows = np.ascontiguousarray(poses, dtype=np.float64)
    return np.array([known.get(pose.tobytes(), -1) for pose in rows], np.int64)


def told_by(options: Options, ratings: Ratings, places: NDArray[np.int64]) -> FloatArray:
    """What proposed views are expected to tell, shape (N,) [full views].

    0 for views that a test ruled out, and for views that were taken before: one look makes all in
    sight certain, so that what is still expected of them never comes.

    Args:
        options: all views.
        ratings: of these.
        places: of the proposed views, shape (N,), see `places_of`.
    """
    told = np.where(places >= 0, ratings.shares[places], 0.0)
    poses, near = options.poses[places], 0.5 * options.surroundings.voxel_size
    for past in options.situation.past_views:
        same = np.linalg.norm(poses[:, :3, 3] - past[:3, 3], axis=1) < near
        same &= poses[:, :3, 2] @ past[:3, 2] > np.cos(_SAME_TURN)
        told[same] = 0.0
    return np.asarray(told)


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
