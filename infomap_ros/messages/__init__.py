"""The one place that knows the bytes of messages.

Decoding: ``decode(type_name, message)`` or a ``decode_*`` function turns a message object of
rosbags or of rclpy, ROS 1 or 2, into records. Whatever is wrong with the message raises
`MalformedMessageError` and nothing else.

Encoding: ``encode(types, record)`` or an ``encode_*`` function builds the message; `MessageTypes`
(one method, ``make(type_name, **fields)``) decides whose message objects are made.
`RosbagsMessageTypes` makes those of rosbags.
"""

from __future__ import annotations

from collections.abc import Callable

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry.records import Record
from infomap_ros.messages.clouds import (
    POINT_CLOUD,
    decode_point_cloud,
    encode_cloud_fields,
    encode_point_cloud,
    encode_range_cloud,
)
from infomap_ros.messages.encode import (
    encode,
    encode_camera_info,
    encode_clock,
    encode_disparity,
    encode_image,
    encode_imu,
    encode_joint_state,
    encode_occupancy_grid,
    encode_odometry,
    encode_pose,
    encode_text,
    encode_transforms,
    message_type_of,
)
from infomap_ros.messages.fields import (
    MessageTypes,
    RosbagsMessageTypes,
    header_stamp,
    make_header,
    make_time,
)
from infomap_ros.messages.images import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    decode_camera_info,
    decode_compressed_image,
    decode_image,
)
from infomap_ros.messages.poses import (
    IMU,
    JOINT_STATE,
    ODOMETRY,
    POSE,
    POSE_WITH_COVARIANCE,
    STRING,
    TF,
    TRANSFORM,
    decode_imu,
    decode_joint_state,
    decode_odometry,
    decode_pose,
    decode_pose_with_covariance,
    decode_text,
    decode_transform,
    decode_transforms,
)

_DECODERS: dict[str, Callable[[object], Record]] = {
    IMAGE: decode_image,
    COMPRESSED_IMAGE: decode_compressed_image,
    CAMERA_INFO: decode_camera_info,
    POINT_CLOUD: decode_point_cloud,
    POSE: decode_pose,
    POSE_WITH_COVARIANCE: decode_pose_with_covariance,
    ODOMETRY: decode_odometry,
    JOINT_STATE: decode_joint_state,
    IMU: decode_imu,
}
_TF_TYPES = (TF, "tf/msg/tfMessage")

DECODABLE_TYPES = frozenset({*_DECODERS, *_TF_TYPES, TRANSFORM, STRING})


def decode(
    type_name: str, message: object, *, stamp: int = 0, is_static: bool = False
) -> tuple[Record, ...]:
    """Turn a message into records.

    Args:
        type_name: ROS 2 name (``sensor_msgs/msg/Image``), one of `DECODABLE_TYPES`.
        message: the object, with the attributes that the type has.
        stamp: when it was received [ns]; used where a type has no header.
        is_static: True for transforms from ``/tf_static``.

    Returns:
        One record, several for a message with several transforms.

    Raises:
        MalformedMessageError: the message contradicts itself, or the type is not decodable.
    """
    if type_name in _DECODERS:
        return (_DECODERS[type_name](message),)
    if type_name in _TF_TYPES:
        return decode_transforms(message, is_static)
    if type_name == TRANSFORM:
        return (decode_transform(message, is_static),)
    if type_name == STRING:
        return (decode_text(message, stamp),)
    raise MalformedMessageError(type_name, "is of a type that is not read")


__all__ = [
    "CAMERA_INFO",
    "COMPRESSED_IMAGE",
    "DECODABLE_TYPES",
    "IMAGE",
    "IMU",
    "JOINT_STATE",
    "ODOMETRY",
    "POINT_CLOUD",
    "POSE",
    "POSE_WITH_COVARIANCE",
    "STRING",
    "TF",
    "TRANSFORM",
    "MessageTypes",
    "RosbagsMessageTypes",
    "decode",
    "decode_camera_info",
    "decode_compressed_image",
    "decode_image",
    "decode_imu",
    "decode_joint_state",
    "decode_odometry",
    "decode_point_cloud",
    "decode_pose",
    "decode_pose_with_covariance",
    "decode_text",
    "decode_transform",
    "decode_transforms",
    "encode",
    "encode_camera_info",
    "encode_clock",
    "encode_cloud_fields",
    "encode_disparity",
    "encode_image",
    "encode_imu",
    "encode_joint_state",
    "encode_occupancy_grid",
    "encode_odometry",
    "encode_point_cloud",
    "encode_pose",
    "encode_range_cloud",
    "encode_text",
    "encode_transforms",
    "header_stamp",
    "make_header",
    "make_time",
    "message_type_of",
]
