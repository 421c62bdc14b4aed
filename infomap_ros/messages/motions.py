"""Plans of motion into messages: next view, base path, arm trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from infomap_ros.geometry import make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.types import MessageTypes, make_header, make_pose
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
