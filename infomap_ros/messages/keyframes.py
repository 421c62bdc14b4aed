"""Poses of keyframes as a ``nav_msgs/Path``: each with a stamp of its own.

A path has no room for covariances; they go beside it, as rows of a ``sensor_msgs/PointCloud2``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError, MalformedMessageError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.clouds import POINT_CLOUD
from infomap_ros.messages.commands import PATH
from infomap_ros.messages.fields import MessageFields
from infomap_ros.messages.motions import encode_pose_stamped
from infomap_ros.messages.poses import decode_pose
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.messages.types import MessageTypes, make_header


@dataclass(frozen=True, eq=False)
class KeyframePoses:
    """Where the camera was at some moments, as it is known now.

    Attributes:
        stamp: of the image that was used last for them [ns].
        frame_id: of the poses.
        stamps: of the keyframes, shape (K,), int64 [ns].
        transforms: pose of the camera at each, shape (K, 4, 4).
        covariances: of the poses in that frame, shape (K, 6, 6); None where not known.
        origin: of the map, as in `PoseUncertainty`; 0 where not known.
    """

    stamp: int
    frame_id: str
    stamps: NDArray[np.int64]
    transforms: FloatArray
    covariances: FloatArray | None = None
    origin: int = 0


KEYFRAME_ROW = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("sec", "<i4"),
        ("nanosec", "<u4"),
        ("origin", "<u4"),
        ("covariance", "<f8", (36,)),
    ]
)
"""A keyframe: its position [m], its stamp, the origin of the map, and the covariance of its pose,
row by row."""


def encode_keyframe_covariances(types: MessageTypes, record: KeyframePoses) -> Any:
    """Build a ``sensor_msgs/PointCloud2`` with a row for each keyframe.

    Raises:
        InvalidInputError: the covariances are not known.
    """
    if record.covariances is None:
        raise InvalidInputError("keyframes", "have no covariances")
    rows = np.zeros(len(record.stamps), KEYFRAME_ROW)
    rows["x"], rows["y"], rows["z"] = record.transforms[:, :3, 3].T
    rows["sec"], rows["nanosec"] = np.divmod(record.stamps, 1_000_000_000)
    rows["origin"] = record.origin
    rows["covariance"] = record.covariances.reshape(-1, 36)
    return encode_rows(types, record.stamp, record.frame_id, rows)


def decode_keyframe_covariances(message: object) -> tuple[int, int, NDArray[np.int64], FloatArray]:
    """Read what `encode_keyframe_covariances` wrote.

    Returns:
        Stamp of the message, origin of the map, stamps of the keyframes, shape (K,) [ns], and
        covariances (K, 6, 6).

    Raises:
        MalformedMessageError: it has other fields, or rows of different origins.
    """
    stamp, _, rows = decode_rows(message)
    if rows.dtype != KEYFRAME_ROW:
        raise MalformedMessageError(POINT_CLOUD, "does not hold covariances of keyframes")
    origins = {int(origin) for origin in rows["origin"]}
    if len(origins) > 1:
        raise MalformedMessageError(POINT_CLOUD, "holds keyframes of different origins")
    stamps = rows["sec"].astype(np.int64) * 1_000_000_000 + rows["nanosec"]
    return stamp, max(origins, default=0), stamps, np.array(rows["covariance"]).reshape(-1, 6, 6)


def encode_keyframe_poses(types: MessageTypes, record: KeyframePoses) -> Any:
    """Build a ``nav_msgs/Path`` whose poses have stamps of their own."""
    poses = [
        encode_pose_stamped(types, stamp, record.frame_id, transform)
        for stamp, transform in zip(record.stamps.tolist(), record.transforms, strict=True)
    ]
    header = make_header(types, record.stamp, record.frame_id)
    return types.make(PATH, header=header, poses=poses)


def decode_keyframe_poses(message: object) -> KeyframePoses:
    """Read a ``nav_msgs/Path`` whose poses have stamps of their own.

    Raises:
        MalformedMessageError: a position is not finite, a quaternion not of unit length, or a
            pose is in another frame than the path.
    """
    fields = MessageFields(message, PATH)
    stamp, frame_id = fields.header()
    poses = [decode_pose(each) for each in fields.value("poses")]
    for pose in poses:
        if pose.frame_id != frame_id:
            fields.fail(f"holds a pose in frame '{pose.frame_id}', the path is in '{frame_id}'")
    return KeyframePoses(
        stamp,
        frame_id,
        np.array([pose.stamp for pose in poses], np.int64),
        np.array([pose.transform for pose in poses]).reshape(-1, 4, 4),
    )
