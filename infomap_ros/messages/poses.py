"""Poses, odometry, transforms, joints and text out of messages."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from infomap_ros.errors import InvalidInputError, MalformedMessageError
from infomap_ros.geometry.records import (
    ImuRecord,
    JointStateRecord,
    OdometryRecord,
    PoseRecord,
    TextRecord,
    TransformRecord,
)
from infomap_ros.geometry.transforms import FloatArray, check_covariance, transform_from_quaternion
from infomap_ros.messages.fields import MessageFields

POSE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
TF = "tf2_msgs/msg/TFMessage"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
STRING = "std_msgs/msg/String"
ABSENT = -1.0  # first number of a covariance in sensor_msgs/Imu: that part is not measured


def decode_pose(message: object) -> PoseRecord:
    """Read a ``geometry_msgs/PoseStamped``; its covariance is unknown.

    Raises:
        MalformedMessageError: the position is not finite or the quaternion not of unit length.
    """
    fields = MessageFields(message, POSE)
    stamp, frame_id = fields.header()
    return PoseRecord(stamp, frame_id, _pose(fields.child("pose")))


def decode_pose_with_covariance(message: object) -> PoseRecord:
    """Read a ``geometry_msgs/PoseWithCovarianceStamped``; a covariance of zeros is unknown.

    Raises:
        MalformedMessageError: as `decode_pose`, or the covariance is not one.
    """
    fields = MessageFields(message, POSE_WITH_COVARIANCE)
    stamp, frame_id = fields.header()
    pose = fields.child("pose")
    return PoseRecord(stamp, frame_id, _pose(pose.child("pose")), _covariance(pose))


def decode_odometry(message: object) -> OdometryRecord:
    """Read a ``nav_msgs/Odometry``; covariances of zeros are unknown.

    Raises:
        MalformedMessageError: as `decode_pose_with_covariance`, or the twist is not finite.
    """
    fields = MessageFields(message, ODOMETRY)
    stamp, frame_id = fields.header()
    pose, twist = fields.child("pose"), fields.child("twist")
    velocity = twist.child("twist")
    return OdometryRecord(
        stamp,
        frame_id,
        _pose(pose.child("pose")),
        _covariance(pose),
        fields.name("child_frame_id").lstrip("/"),
        twist=np.concatenate(
            [_vector(velocity.child("linear")), _vector(velocity.child("angular"))]
        ),
        twist_covariance=_covariance(twist),
    )


def decode_joint_state(message: object) -> JointStateRecord:
    """Read a ``sensor_msgs/JointState``.

    Drivers leave NaN where they have no sensor: a joint without a position is left out, and where
    one has no velocity none is told.

    Raises:
        MalformedMessageError: names and positions (or velocities, where there are any) differ in
            number, or a name is there twice.
    """
    fields = MessageFields(message, JOINT_STATE)
    stamp, frame_id = fields.header()
    names, positions = fields.names("name"), fields.numbers("position", finite=False)
    velocities = fields.numbers("velocity", finite=False)
    if len(positions) != len(names):
        fields.fail(f"has {len(names)} names but {len(positions)} positions")
    if len(velocities) not in (0, len(names)):
        fields.fail(f"has {len(names)} names but {len(velocities)} velocities")
    if len(set(names)) != len(names):
        fields.fail("names a joint twice")
    known = np.isfinite(positions)
    have_velocities = len(velocities) > 0 and np.isfinite(velocities[known]).all()
    return JointStateRecord(
        stamp,
        frame_id,
        tuple(name for name, is_known in zip(names, known, strict=True) if is_known),
        positions[known],
        velocities[known] if have_velocities else None,
    )


def decode_imu(message: object) -> ImuRecord:
    """Read a ``sensor_msgs/Imu``; its orientation is not read.

    Raises:
        MalformedMessageError: an angular velocity is not finite, or it says that it has none.
    """
    fields = MessageFields(message, IMU)
    if fields.numbers("angular_velocity_covariance", size=9)[0] == ABSENT:
        fields.fail("has no angular velocity")
    acceleration = None
    if fields.numbers("linear_acceleration_covariance", size=9)[0] != ABSENT:
        with suppress(MalformedMessageError):  # NaN, where there is no accelerometer
            acceleration = _vector(fields.child("linear_acceleration"))
    return ImuRecord(*fields.header(), _vector(fields.child("angular_velocity")), acceleration)


def decode_transforms(message: object, is_static: bool = False) -> tuple[TransformRecord, ...]:
    """Read a ``tf2_msgs/TFMessage`` (``tf/tfMessage`` in old ROS 1 bags).

    Args:
        message: the message.
        is_static: True where it came from ``/tf_static``.

    Raises:
        MalformedMessageError: a transform is not rigid, or a frame has no name or is its own
            parent.
    """
    fields = MessageFields(message, TF)
    return tuple(_transform(part, is_static) for part in fields.children("transforms"))


def decode_transform(message: object, is_static: bool = False) -> TransformRecord:
    """Read a ``geometry_msgs/TransformStamped``; raises as `decode_transforms`."""
    return _transform(MessageFields(message, TRANSFORM), is_static)


def decode_text(message: object, stamp: int = 0) -> TextRecord:
    """Read a ``std_msgs/String``, which has no header: `stamp` [ns] is when it was received.

    Raises:
        MalformedMessageError: it holds no string.
    """
    return TextRecord(stamp, "", MessageFields(message, STRING).text("data"))


def _transform(fields: MessageFields, is_static: bool) -> TransformRecord:
    stamp, parent = fields.header()
    child = fields.name("child_frame_id").lstrip("/")
    if not parent or not child or parent == child:
        fields.fail(f"{fields.path}frames '{parent}' and '{child}' are not parent and child")
    part = fields.child("transform")
    transform = _rigid(part, part.child("translation"), part.child("rotation"))
    return TransformRecord(stamp, parent, child, transform, is_static)


def _vector(fields: MessageFields) -> FloatArray:
    return np.array([fields.number("x"), fields.number("y"), fields.number("z")])


def _pose(fields: MessageFields) -> FloatArray:
    return _rigid(fields, fields.child("position"), fields.child("orientation"))


def _rigid(fields: MessageFields, offset: MessageFields, rotation: MessageFields) -> FloatArray:
    quaternion = [*_vector(rotation), rotation.number("w")]
    try:
        return transform_from_quaternion(quaternion, _vector(offset))
    except InvalidInputError as error:
        raise MalformedMessageError(fields.message_type, f"{fields.path}{error}") from error


def _covariance(fields: MessageFields) -> FloatArray | None:
    """Covariance (6, 6) of a pose or twist; None where it is all zero, ROS's word for unknown."""
    matrix = fields.numbers("covariance", size=36).reshape(6, 6)
    if not matrix.any():
        return None
    try:
        return check_covariance(matrix, 6)
    except (InvalidInputError, np.linalg.LinAlgError) as error:
        problem = f"{fields.path}covariance cannot be used: {error}"
        raise MalformedMessageError(fields.message_type, problem) from error
