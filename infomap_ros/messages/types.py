"""Who makes the messages that the encoders fill: rosbags here, rclpy in the nodes."""

from __future__ import annotations

from typing import Any, Protocol

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from infomap_ros.geometry.transforms import FloatArray, quaternion_from_transform

_NANOSECONDS = 1_000_000_000


class MessageTypes(Protocol):
    """A family of message classes.

    An implementation for rclpy imports the class by its name and turns a numpy array into what
    rclpy wants: the array itself for a fixed-size field, ``array.array(...)`` by ``frombytes`` for
    a sequence.
    """

    def make(self, type_name: str, /, **fields: Any) -> Any:
        """Build one message.

        Args:
            type_name: ROS 2 name, for example ``sensor_msgs/msg/Image``.
            fields: all fields of the type. Values are bool, int, float, str, messages made by the
                same family, lists of such messages or of str, or one-dimensional, contiguous numpy
                arrays of exactly the field's element type (uint8 for ``Image.data``, float64 for
                ``CameraInfo.k`` and ``JointState.position``, int8 for ``OccupancyGrid.data``).

        Returns:
            The message object.
        """


class RosbagsMessageTypes:
    """Messages as rosbags serializes them (ROS 2 Jazzy)."""

    def __init__(self, store: Typestore | None = None) -> None:
        self._store = store or get_typestore(Stores.ROS2_JAZZY)

    def make(self, type_name: str, /, **fields: Any) -> Any:
        """Build one message; see `MessageTypes.make`."""
        return self._store.types[type_name](**fields)


def make_time(types: MessageTypes, stamp: int) -> Any:
    """A ``builtin_interfaces/Time`` from nanoseconds."""
    seconds, nanoseconds = divmod(int(stamp), _NANOSECONDS)
    return types.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def make_header(types: MessageTypes, stamp: int, frame_id: str) -> Any:
    """A ``std_msgs/Header``; stamp [ns]."""
    return types.make("std_msgs/msg/Header", stamp=make_time(types, stamp), frame_id=frame_id)


def make_vector(types: MessageTypes, values: FloatArray) -> Any:
    """A ``geometry_msgs/Vector3`` from shape (3,)."""
    x, y, z = (float(value) for value in values)
    return types.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def make_quaternion(types: MessageTypes, transform: FloatArray) -> Any:
    """A ``geometry_msgs/Quaternion`` from the rotation of a transform, shape (4, 4)."""
    x, y, z, w = (float(value) for value in quaternion_from_transform(transform))
    return types.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def make_pose(types: MessageTypes, transform: FloatArray) -> Any:
    """A ``geometry_msgs/Pose`` from a transform, shape (4, 4)."""
    x, y, z = (float(value) for value in transform[:3, 3])
    point = types.make("geometry_msgs/msg/Point", x=x, y=y, z=z)
    orientation = make_quaternion(types, transform)
    return types.make("geometry_msgs/msg/Pose", position=point, orientation=orientation)


def make_region(types: MessageTypes, x: int, y: int, width: int, height: int) -> Any:
    """A ``sensor_msgs/RegionOfInterest`` [px]; all zero is the whole image."""
    return types.make(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=x,
        y_offset=y,
        height=height,
        width=width,
        do_rectify=False,
    )
