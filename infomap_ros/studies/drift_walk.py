"""One walk of the drift study, and where each method believes the camera to be."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.free_motion import free_motion
from infomap_ros.studies.camera_motion import estimate_motion, printed_motion
from infomap_ros.studies.fiducial_walk import CAMERA, WalkConfig, WalkFrame, walk

NECESSARY = 4
"""Fiducials that eq. (14) needs for its 12 unknowns."""

_STEP_TIME = 0.2  # [s], for the prior of a camera that may move anywhere


@dataclass(frozen=True, eq=False)
class WalkErrors:
    """Distance from the true position by each method, shape (steps + 1,) each [m].

    Attributes:
        printed: by eq. (14).
        weighted: by `estimate_motion`.
        default: by `FiducialFilter`.
    """

    printed: FloatArray
    weighted: FloatArray
    default: FloatArray


METHODS = tuple(field.name for field in dataclasses.fields(WalkErrors))


@dataclass(frozen=True)
class WalkTask:
    """One walk: implements `infomap_ros.studies.common.runs.Task`.

    Attributes:
        distance: mean distance of the fiducials [m].
        redundancy: multiple of the necessary number of fiducials.
        number: of the walk.
        seed: of the study.
        walk: noise and steps.
    """

    distance: float
    redundancy: int
    number: int
    seed: int
    walk: WalkConfig

    @property
    def file_name(self) -> str:
        """Where the result is kept."""
        return f"{1e3 * self.distance:.0f}mm_{self.redundancy}x_{self.number}.npz"

    def fingerprint(self) -> str:
        """All that the result depends on, but for the code."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def run(self) -> WalkErrors:
        """Walk and compare with the truth."""
        source = [self.seed, self.number, self.redundancy, int(1e3 * self.distance)]
        rng = np.random.default_rng(source)
        frames = list(walk(self.walk, NECESSARY * self.redundancy, self.distance, rng))
        truth = np.array([frame.T_map_camera[:3, 3] for frame in frames])
        found = _positions(frames)
        return WalkErrors(*(np.linalg.norm(found[m] - truth, axis=1) for m in METHODS))


def _positions(frames: Sequence[WalkFrame]) -> dict[str, FloatArray]:
    """Estimated positions by each method, shape (steps + 1, 3) [m]."""
    return {
        "printed": _composed(frames, _printed),
        "weighted": _composed(frames, _weighted),
        "default": _filtered(frames),
    }


Pair = tuple[FiducialObservations, FiducialObservations]


def _composed(frames: Sequence[WalkFrame], motion: Callable[[Pair], FloatArray]) -> FloatArray:
    """Positions from motions between neighboring frames."""
    pose = np.eye(4)
    positions = [pose[:3, 3]]
    for before, after in pairwise(frames):
        pair = tuple(
            frame.observations.select(_order(frame.observations, before.followed))
            for frame in (before, after)
        )
        pose = pose @ invert_transform(motion((pair[0], pair[1])))
        positions.append(pose[:3, 3])
    return np.array(positions)


def _order(observations: FiducialObservations, ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices of ids in observations."""
    order = np.argsort(observations.ids)
    return np.asarray(order[np.searchsorted(observations.ids, ids, sorter=order)])


def _printed(pair: Pair) -> FloatArray:
    try:
        return printed_motion(pair[0].points(CAMERA), pair[1].points(CAMERA))
    except InvalidInputError:  # four points in one plane: counts as no motion
        return np.eye(4)


def _weighted(pair: Pair) -> FloatArray:
    before, after = pair
    estimate = estimate_motion(
        before.points(CAMERA), before.covariances(CAMERA),
        after.points(CAMERA), after.covariances(CAMERA),
    )  # fmt: skip
    # A step without an estimate counts as no motion: its error stays in the result.
    return np.eye(4) if estimate.T_after_before is None else estimate.T_after_before


def _filtered(frames: Sequence[WalkFrame]) -> FloatArray:
    """Positions by the filter, from images alone."""
    config = FiducialFilterConfig(min_fiducials=NECESSARY, max_kept_poses=2)
    pose_filter = FiducialFilter(CAMERA, config)
    pose_filter.add(frames[0].observations)
    positions = [np.zeros(3)]
    for frame in frames[1:]:
        pose_filter.predict(free_motion(_STEP_TIME))
        update = pose_filter.update(frame.observations)
        new = np.isin(frame.observations.ids, update.unknown)
        pose_filter.add(frame.observations.select(new))
        positions.append(pose_filter.pose[0][:3, 3])
    return np.array(positions)
