"""Plans of motion into messages: next view, base path, arm trajectory.

Poses of keyframes as a ``nav_msgs/Path``: each with a stamp of its own.

A path has no room for covariances; they go beside it, as rows of a ``sensor_msgs/PointCloud2``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError, MalformedMessageError
from infomap_ros.geometry import make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.clouds import POINT_CLOUD
from infomap_ros.messages.commands import PATH
from infomap_ros.messages.fields import MessageFields, MessageTypes, make_header, make_pose
from infomap_ros.messages.poses import decode_pose
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.motion.arm.controller_trajectories import stopping_path
from infomap_ros.motion.route import ArmPath

_NANOSECONDS = 1_000_000_000


def encode_pose_stamped(
    types: MessageTypes, stamp: int, frame_id: str, transform: FloatArray
) -> Any:
    """Build a ``geometry_msgs/PoseStamped``; stamp [ns], ``T_frame_pose`` (4, 4)."""
    return types.make(
        "geometry_msgs/msg/PoseStamped",
        header=make_header(types, stamp, frame_id),
        pose=make_pose(types, transform),
    )


def encode_base_path(types: MessageTypes, stamp: int, frame_id: str, poses: FloatArray) -> Any:
    """Build a ``nav_msgs/Path``.

    Args:
        types: who makes the message.
        stamp: [ns].
        frame_id: frame of the poses.
        poses: x, y [m] and yaw [rad], shape (K, 3), or transforms, shape (K, 4, 4).
    """
    transforms = poses if poses.ndim == 3 else [_planar_transform(*pose) for pose in poses]
    return types.make(
        "nav_msgs/msg/Path",
        header=make_header(types, stamp, frame_id),
        poses=[encode_pose_stamped(types, stamp, frame_id, each) for each in transforms],
    )


def encode_arm_trajectory(
    types: MessageTypes,
    stamp: int,
    path: ArmPath,
    velocities: FloatArray | None = None,
    label: str = "",
) -> Any:
    """Build a ``trajectory_msgs/JointTrajectory``.

    Args:
        types: who makes the message.
        stamp: when it begins [ns]; 0 for when it arrives, whatever the clocks say.
        path: of the arm.
        velocities: at its knots, as its positions [rad/s or m/s]; None for none.
        label: frame_id of the header, which has no meaning for joints: by it a result names the
            trajectory that it is of.
    """
    none = np.zeros(0)
    rows = [none] * len(path.positions) if velocities is None else velocities
    return types.make(
        "trajectory_msgs/msg/JointTrajectory",
        header=make_header(types, stamp, label),
        joint_names=list(path.joint_names),
        points=[
            types.make(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                positions=np.array(positions),
                velocities=np.array(speeds),
                accelerations=none,
                effort=none,
                time_from_start=encode_duration(types, float(time)),
            )
            for positions, speeds, time in zip(path.positions, rows, path.times, strict=True)
        ],
    )


def encode_arm_stop(
    types: MessageTypes,
    joint_names: Sequence[str],
    positions: Mapping[str, float],
    velocities: Mapping[str, float],
) -> Any:
    """Build the ``trajectory_msgs/JointTrajectory`` by which joints slow down and stand.

    Args:
        types: who makes the message.
        joint_names: which joints.
        positions: of these at least, by name [rad or m].
        velocities: by name [rad/s or m/s]; a joint that is not there stands.
    """
    here = np.array([positions[name] for name in joint_names])
    speeds = np.array([velocities.get(name, 0.0) for name in joint_names])
    path = stopping_path(tuple(joint_names), here, speeds)
    return encode_arm_trajectory(types, 0, path, np.zeros_like(path.positions))


def encode_duration(types: MessageTypes, seconds: float) -> Any:
    """Build a ``builtin_interfaces/Duration`` from a time [s]."""
    whole, rest = divmod(round(seconds * _NANOSECONDS), _NANOSECONDS)
    return types.make("builtin_interfaces/msg/Duration", sec=whole, nanosec=rest)


def _planar_transform(x: float, y: float, yaw: float) -> FloatArray:
    c, s = np.cos(yaw), np.sin(yaw)
    return make_transform(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), (x, y, 0.0))


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
