"""Views that a strategy proposed, found again among the options."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.options import Options

_BELOW = -1e9  # of views that a strategy did not propose


def places_of(options: Options, poses: FloatArray) -> NDArray[np.int64]:
    """Which option each pose, shape (N, 4, 4), is; -1 for those that a test ruled out."""
    known = {
        pose.tobytes(): index for index, pose in enumerate(np.ascontiguousarray(options.poses))
    }
    rows = np.ascontiguousarray(poses, dtype=np.float64)
    return np.array([known.get(pose.tobytes(), -1) for pose in rows], np.int64)


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
