"""Commands to a robot out of messages: velocity, base path, arm trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.fields import MessageFields
from infomap_ros.messages.poses import decode_pose

TWIST = "geometry_msgs/msg/Twist"
PATH = "nav_msgs/msg/Path"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"


@dataclass(frozen=True, eq=False)
class BasePathCommand:
    """A path for the base.

    Attributes:
        frame_id: frame of the poses.
        poses: x, y [m] and yaw [rad], shape (K, 3); no pose means to stop.
    """

    frame_id: str
    poses: FloatArray


@dataclass(frozen=True, eq=False)
class ArmTrajectoryCommand:
    """A trajectory for the arm.

    Attributes:
        names: n joints.
        positions: knots, shape (K, n) [rad or m].
        times: from the start, shape (K,) [s].
        velocities: at the knots, shape (K, n) [rad/s or m/s]; None where it has none.
        stamp: when it begins [ns]; 0: at once.
        label: frame_id of its header.
    """

    names: tuple[str, ...]
    positions: FloatArray
    times: FloatArray
    velocities: FloatArray | None = None
    stamp: int = 0
    label: str = ""


def decode_velocity(message: object) -> tuple[float, float]:
    """Read forward speed [m/s] and turn rate [rad/s] of a ``geometry_msgs/Twist``.

    Raises:
        MalformedMessageError: a number is not finite.
    """
    fields = MessageFields(message, TWIST)
    return fields.child("linear").number("x"), fields.child("angular").number("z")


def decode_base_path(message: object) -> BasePathCommand:
    """Read a ``nav_msgs/Path``.

    Raises:
        MalformedMessageError: a position is not finite or a quaternion not of unit length.
    """
    fields = MessageFields(message, PATH)
    _, frame_id = fields.header()
    poses = [decode_pose(each).transform for each in fields.value("poses")]
    planar = [(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])) for T in poses]
    return BasePathCommand(frame_id, np.array(planar).reshape(-1, 3))


def decode_arm_trajectory(message: object) -> ArmTrajectoryCommand:
    """Read a ``trajectory_msgs/JointTrajectory``; accelerations and efforts in it are not used.

    Raises:
        MalformedMessageError: no points, or a point has not one position for each joint, or some
            velocities and not one for each.
    """
    fields = MessageFields(message, JOINT_TRAJECTORY)
    stamp, label = fields.header()
    names = fields.names("joint_names")
    points = fields.children("points")
    if not names or not points:
        fields.fail(f"has {len(names)} joints and {len(points)} points")
    positions = [point.numbers("positions") for point in points]
    for index, row in enumerate(positions):
        if len(row) != len(names):
            fields.fail(f"points[{index}] has {len(row)} positions for {len(names)} joints")
    times = [_seconds(point.child("time_from_start")) for point in points]
    return ArmTrajectoryCommand(
        names, np.array(positions), np.array(times), _velocities(fields, len(names)), stamp, label
    )


def _velocities(fields: MessageFields, joints: int) -> FloatArray | None:
    rows = [point.numbers("velocities") for point in fields.children("points")]
    if all(len(row) == 0 for row in rows):
        return None
    for index, row in enumerate(rows):
        if len(row) != joints:
            fields.fail(f"points[{index}] has {len(row)} velocities for {joints} joints")
    return np.array(rows)


def _seconds(fields: MessageFields) -> float:
    return fields.integer("sec", -(2**31), 2**31 - 1) + 1e-9 * fields.integer("nanosec")
