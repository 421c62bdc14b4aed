"""Which explanation of an image is right, if any can be trusted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from infomap_ros.geometry import invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.consensus import agreeing, find_pose
from infomap_ros.localization.filter_config import FiducialFilterConfig
from infomap_ros.localization.invariant_state import InvariantState
from infomap_ros.localization.motion_prior import MotionPrior
from infomap_ros.localization.pose_hypothesis import Expectation, Hypothesis, examine
from infomap_ros.localization.sight import Measured

_MOST = 3


def hypotheses(
    state: InvariantState,
    prior: MotionPrior,
    indices: NDArray[np.int64],
    measured: Measured,
    config: FiducialFilterConfig,
) -> list[Hypothesis]:
    """Explanations of an image, each by other fiducials: largest group first, as RANSAC finds them.

    Args:
        state: before the motion.
        prior: of the motion.
        indices: of the image's fiducials in the state, shape (M,).
        measured: their measurements.
        config: gates.
    """
    turn = state.T_map_camera[:3, :3] @ prior.T_before_after[:3, :3]
    covariances = turn.T @ _relative_covariances(state, indices) @ turn
    positions = state.positions[indices]
    gate = float(chdtri(3, 1.0 - config.fiducial_gate))
    remaining = np.ones(len(indices), bool)
    found: list[Hypothesis] = []
    while len(found) < _MOST and np.count_nonzero(remaining) >= config.least_fiducials:
        some = np.flatnonzero(remaining)
        pose = find_pose(
            positions[some], covariances[some], measured.select(some), gate, config.trials
        )
        if pose is None:
            break
        members = np.zeros(len(indices), bool)
        members[some] = agreeing(
            pose, positions[some], covariances[some], measured.select(some), gate
        )
        expectation = Expectation.at(state, prior, invert_transform(pose))
        hypothesis = examine(state, expectation, indices, measured, members, config)
        if hypothesis is None:
            break
        found.append(hypothesis)
        remaining &= ~(hypothesis.members | members)
    return found


def choose(
    found: Sequence[Hypothesis], known: int, config: FiducialFilterConfig
) -> tuple[Hypothesis | None, str]:
    """The hypothesis to believe, or None and the reason.

    Args:
        found: the hypotheses.
        known: number of known fiducials in the image.
        config: gates.
    """
    if known < config.least_fiducials:
        return None, f"{known} known fiducials in view, {config.least_fiducials} needed"
    sound = [one for one in found if one.has_plausible_residuals(config)]
    plausible = [one for one in sound if one.has_plausible_motion(config)]
    if not plausible:
        if sound:
            return None, "the motion that the fiducials show contradicts the expected one"
        return None, "the fiducials do not agree on one pose"
    plausible.sort(key=lambda one: -one.count)
    if len(plausible) > 1 and plausible[1].count >= config.ambiguity * plausible[0].count:
        return None, "two groups of fiducials show different motions"
    return plausible[0], ""


def _relative_covariances(state: InvariantState, indices: NDArray[np.int64]) -> FloatArray:
    """Of fiducials relative to the camera before the motion, in the map's axes, (M, 3, 3)."""
    rows = state.fiducial_rows(indices)
    P = state.P
    own = P[rows[:, :, None], rows[:, None, :]]
    cross = P[rows[:, :, None], np.arange(3)[None, None, :]]
    return np.asarray(own + P[:3, :3] - cross - cross.transpose(0, 2, 1))
