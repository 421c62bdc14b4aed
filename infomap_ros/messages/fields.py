"""Checked access to the fields of a message, whoever made the object.

rosbags gives dataclasses whose sequences are numpy arrays, rclpy gives objects whose sequences are
``array.array``, numpy arrays or lists. Both go through `MessageFields`, and whatever does not hold
what its type promises ends as `MalformedMessageError`.

Who makes the messages that the encoders fill: rosbags here, rclpy in the nodes.

What can be read of a serialized message without its type.
"""

from __future__ import annotations

import array
import math
import struct
from numbers import Integral, Real
from typing import Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry.transforms import FloatArray, quaternion_from_transform

_NANOSECONDS = 1_000_000_000
_LONGEST_NAME = 256
_BYTE_CONTAINERS = (bytes, bytearray, memoryview, array.array)


class MessageFields:
    """The fields of one message (or of a message inside it).

    Attributes:
        message_type: ROS type name of the whole message, for errors.
        path: where inside the message this part is, empty or ending in a dot.
    """

    def __init__(self, message: object, message_type: str, path: str = "") -> None:
        self._message = message
        self.message_type = message_type
        self.path = path

    def fail(self, problem: str) -> NoReturn:
        """Raise `MalformedMessageError` for this message."""
        raise MalformedMessageError(self.message_type, problem)

    def value(self, *names: str) -> Any:
        """The first field among `names` that exists (ROS 1 and 2 differ in a few names)."""
        for name in names:
            if hasattr(self._message, name):
                return getattr(self._message, name)
        self.fail(f"has no field {self.path}{names[0]}")

    def child(self, name: str) -> MessageFields:
        """A message inside this one."""
        return MessageFields(self.value(name), self.message_type, f"{self.path}{name}.")

    def children(self, name: str) -> list[MessageFields]:
        """A sequence of messages inside this one."""
        elements = self.value(name)
        if not isinstance(elements, (list, tuple)):
            self.fail(f"{self.path}{name} is not a sequence of messages")
        return [
            MessageFields(element, self.message_type, f"{self.path}{name}[{index}].")
            for index, element in enumerate(elements)
        ]

    def text(self, name: str) -> str:
        """A string."""
        value = self.value(name)
        if not isinstance(value, str):
            self.fail(f"{self.path}{name} is {type(value).__name__}, expected a string")
        return value

    def name(self, name: str) -> str:
        """A string that names something: printable, so that logs and terminals may show it."""
        return self._checked_name(name, self.text(name))

    def _checked_name(self, field: str, text: str) -> str:
        if len(text) > _LONGEST_NAME:
            self.fail(f"{self.path}{field} is a name of {len(text)} letters")
        if not text.isprintable():
            self.fail(f"{self.path}{field} is {text!r}, expected a printable name")
        return text

    def integer(self, name: str, low: int = 0, high: int = 2**32 - 1) -> int:
        """A whole number within [low, high]."""
        value = self.value(name)
        if not isinstance(value, (Integral, np.bool_)):
            self.fail(f"{self.path}{name} is {type(value).__name__}, expected a whole number")
        number = int(value)
        if not low <= number <= high:
            self.fail(f"{self.path}{name} is {number}, expected {low} to {high}")
        return number

    def number(self, name: str) -> float:
        """A finite number."""
        value = self.value(name)
        try:
            number = float(value) if isinstance(value, Real) else math.nan
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.fail(f"{self.path}{name} is {value!r}, expected a finite number")
        return number

    def numbers(self, *names: str, size: int | None = None, finite: bool = True) -> FloatArray:
        """A sequence of numbers, shape (n,), float64; `size` is n where the type says so.

        They must be finite unless `finite` is false.
        """
        value = self.value(*names)
        try:
            numbers = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise MalformedMessageError(
                self.message_type, f"{self.path}{names[0]} is not a sequence of numbers"
            ) from error
        if numbers.ndim != 1 or (size is not None and len(numbers) != size):
            expected = "a sequence" if size is None else f"{size} numbers"
            self.fail(f"{self.path}{names[0]} has shape {numbers.shape}, expected {expected}")
        if finite and not np.isfinite(numbers).all():
            self.fail(f"{self.path}{names[0]} holds NaN or infinity")
        return numbers

    def names(self, name: str) -> tuple[str, ...]:
        """A sequence of names, see `name`."""
        value = self.value(name)
        if not isinstance(value, (list, tuple)) or not all(isinstance(v, str) for v in value):
            self.fail(f"{self.path}{name} is not a sequence of strings")
        return tuple(self._checked_name(name, text) for text in value)

    def data(self, name: str = "data") -> NDArray[np.uint8]:
        """A byte sequence without a copy, shape (n,), uint8."""
        value = self.value(name)
        if isinstance(value, np.ndarray):
            if value.dtype not in (np.uint8, np.int8) or value.ndim != 1:
                self.fail(f"{self.path}{name} has type {value.dtype}, expected bytes")
            return np.ascontiguousarray(value).view(np.uint8)
        if isinstance(value, _BYTE_CONTAINERS):
            if memoryview(value).itemsize != 1:
                self.fail(f"{self.path}{name} does not hold bytes")
            return np.frombuffer(value, dtype=np.uint8)
        self.fail(f"{self.path}{name} is {type(value).__name__}, expected bytes")

    def stamp(self, name: str = "stamp") -> int:
        """A time [ns since the epoch of its clock]."""
        time = self.child(name)
        seconds = time.integer("sec", high=2**31 - 1)
        return seconds * _NANOSECONDS + time.integer("nanosec", high=_NANOSECONDS - 1)

    def header(self) -> tuple[int, str]:
        """Stamp [ns] and frame of the header."""
        header = self.child("header")
        return header.stamp(), header.name("frame_id").lstrip("/")


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


_LITTLE_ENDIAN_FLAG = 1


def header_stamp(data: bytes) -> int:
    """Stamp [ns] of a CDR message whose first field is a ``std_msgs/Header``.

    Args:
        data: the message with its encapsulation (4 bytes) before it.

    Raises:
        MalformedMessageError: it is too short to have a header.
    """
    if len(data) < 12:
        raise MalformedMessageError("std_msgs/msg/Header", f"{len(data)} bytes are too few")
    order = "<" if data[1] & _LITTLE_ENDIAN_FLAG else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
