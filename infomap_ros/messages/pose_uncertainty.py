"""The parts of a pose's covariance as a ``sensor_msgs/PointCloud2`` of one row.

A ``geometry_msgs/PoseWithCovarianceStamped`` holds the sum of the parts alone. They go beside it,
with the stamp and the frame of the pose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError, MalformedMessageError
from infomap_ros.geometry import PoseUncertainty
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.clouds import POINT_CLOUD
from infomap_ros.messages.fields import MessageTypes
from infomap_ros.messages.rows import decode_rows, encode_rows

_UPPER_6 = np.triu_indices(6)
_PARTS = ("drift", "white", "offset")

POSE_UNCERTAINTY_ROW = np.dtype(
    [("clock", "<f8"), ("origin", "<u4"), *((part, "<f8", (len(_UPPER_6[0]),)) for part in _PARTS)]
)
"""Clock, origin and the upper triangle, row by row, of each part of `PoseUncertainty` [m, rad]."""


def encode_pose_uncertainty(
    types: MessageTypes, stamp: int, frame_id: str, uncertainty: PoseUncertainty
) -> Any:
    """Build a ``sensor_msgs/PointCloud2`` of one row of `POSE_UNCERTAINTY_ROW`.

    Args:
        types: who makes the message.
        stamp: of the pose [ns].
        frame_id: of the pose.
        uncertainty: of the pose.
    """
    rows = np.zeros(1, POSE_UNCERTAINTY_ROW)
    rows["clock"], rows["origin"] = uncertainty.clock, uncertainty.origin
    for part in _PARTS:
        rows[part] = getattr(uncertainty, part)[_UPPER_6]
    return encode_rows(types, stamp, frame_id, rows)


def decode_pose_uncertainty(message: object) -> tuple[int, str, PoseUncertainty]:
    """Read what `encode_pose_uncertainty` wrote.

    Returns:
        Stamp [ns] and frame of the pose, and its uncertainty.

    Raises:
        MalformedMessageError: it has other fields or another number of rows, a part is no
            covariance, or the clock is not finite.
    """
    stamp, frame_id, rows = decode_rows(message)
    if rows.dtype != POSE_UNCERTAINTY_ROW or len(rows) != 1:
        raise MalformedMessageError(POINT_CLOUD, "does not hold the uncertainty of one pose")
    clock = float(rows["clock"][0])
    if not np.isfinite(clock):
        raise MalformedMessageError(POINT_CLOUD, f"the clock reads {clock}")
    try:
        drift, white, offset = (_symmetric(rows[part][0]) for part in _PARTS)
        origin = int(rows["origin"][0])
        return stamp, frame_id, PoseUncertainty(drift, white, offset, clock, origin)
    except (InvalidInputError, np.linalg.LinAlgError) as error:
        raise MalformedMessageError(POINT_CLOUD, str(error)) from error


def _symmetric(upper: NDArray[np.float64]) -> FloatArray:
    """The matrix, shape (6, 6), of an upper triangle, shape (21,)."""
    matrix = np.zeros((6, 6))
    matrix[_UPPER_6] = upper
    matrix.T[_UPPER_6] = upper
    return matrix
