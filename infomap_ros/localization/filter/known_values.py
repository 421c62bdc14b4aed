"""What the filter's state says of poses and fiducials, by the package's convention of errors."""

from __future__ import annotations

import numpy as np

from infomap_ros.localization.filter.invariant_state import InvariantState
from infomap_ros.localization.filter.lie import skews
from infomap_ros.localization.filter.pose_errors import pose_covariances
from infomap_ros.localization.filter.records import Fiducials, KeptPoses


def known_poses(state: InvariantState) -> KeptPoses:
    """The kept poses of a state."""
    rows = state.kept_rows()
    errors = state.covariance(rows[:, :, None], rows[:, None, :])
    covariances = pose_covariances(state.kept, errors)
    return KeptPoses(state.stamps.copy(), state.kept.copy(), covariances)


def known_fiducials(state: InvariantState) -> Fiducials:
    """The fiducials of a state."""
    rows = state.fiducial_rows(slice(None))
    over = np.zeros((len(rows), 3, 6))
    over[:, :, :3] = np.eye(3)
    over[:, :, 3:] = -skews(state.positions)
    rows = np.hstack([rows, np.broadcast_to(np.arange(3, 6), rows.shape)])
    errors = state.covariance(rows[:, :, None], rows[:, None, :])
    covariances = over @ errors @ over.transpose(0, 2, 1)
    return Fiducials(state.ids.copy(), state.positions.copy(), covariances)
