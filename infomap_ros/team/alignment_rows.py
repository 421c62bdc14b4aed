"""Where a robot's map belongs, told by a teammate in a message that the team's key can sign.

As map updates, it is rows of named fields, here one row, with the header in the name of one more
field: whom it is for, the frame, and the stamp of the image by which it was found.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PoseRecord, check_transform
from infomap_ros.geometry.transforms import check_covariance
from infomap_ros.team.message_header import (
    dtype_with_header,
    header_of,
    whole_number,
    without_header,
)
from infomap_ros.team.update import MAX_ROBOT

ALIGNMENT_ROW = np.dtype([("T_new_old", "<f8", (12,)), ("covariance", "<f8", (36,))])
"""The upper three rows of the transform, and its covariance (`geometry.transforms`), by rows."""

_WHAT = "alignment"
_MAX_STAMP = 2**63 - 1


def encode_alignment(alignment: PoseRecord, robot: int) -> NDArray[np.void]:
    """The row that tells a robot to move its map.

    Args:
        alignment: ``T_new_old`` with its covariance, in the map frame.
        robot: id of the robot.
    """
    header = {_WHAT: robot, "frame": alignment.frame_id, "stamp": alignment.stamp}
    rows = np.zeros(1, dtype_with_header(ALIGNMENT_ROW, header))
    rows["T_new_old"] = alignment.transform[:3].reshape(-1)
    if alignment.covariance is not None:
        rows["covariance"] = alignment.covariance.reshape(-1)
    return rows


def decode_alignment(rows: NDArray[np.void]) -> tuple[int, PoseRecord]:
    """Read such a row: id of the robot that is told, and what; zeros are an unknown covariance.

    Raises:
        InvalidInputError: it is not one, or its numbers are no transform or covariance.
    """
    header = header_of(rows, _WHAT)
    robot = whole_number(header, _WHAT, 0, MAX_ROBOT, _WHAT)
    stamp = whole_number(header, "stamp", 0, _MAX_STAMP, _WHAT)
    table = without_header(rows, (ALIGNMENT_ROW,))
    if len(table) != 1:
        raise InvalidInputError(_WHAT, f"of {len(table)} rows, expected one")
    transform = np.vstack([table["T_new_old"][0].reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    told = table["covariance"][0].reshape(6, 6)
    covariance = check_covariance(told, 6) if told.any() else None
    alignment = check_transform(transform, "T_new_old")
    return robot, PoseRecord(stamp, header.get("frame", ""), alignment, covariance)
