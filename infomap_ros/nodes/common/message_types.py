"""The messages of rclpy for the encoders of `infomap_ros.messages`."""

from __future__ import annotations

import importlib
from array import array
from functools import cache
from typing import Any

import numpy as np

_ARRAY_CODES = {
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


@cache
def message_class(type_name: str) -> type:
    """The rclpy class of a message or service type.

    Args:
        type_name: for example ``sensor_msgs/msg/Image``.

    Raises:
        ModuleNotFoundError: its package is not installed.
        AttributeError: its package has no such type.
    """
    package, kind, name = type_name.split("/")
    found: type = getattr(importlib.import_module(f"{package}.{kind}"), name)
    return found


class RclpyMessageTypes:
    """Makes rclpy messages; see `infomap_ros.messages.MessageTypes`."""

    def make(self, type_name: str, /, **fields: Any) -> Any:
        """Build one message.

        A numpy array becomes an ``array.array`` where the field is a sequence: rclpy would copy
        anything else element by element.
        """
        message = message_class(type_name)()
        kinds = message.get_fields_and_field_types()
        for name, value in fields.items():
            if isinstance(value, np.ndarray) and kinds[name].startswith("sequence"):
                value = _sequence(value)
            setattr(message, name, value)
        return message


def _sequence(values: np.ndarray[Any, Any]) -> array[Any]:
    sequence = array(_ARRAY_CODES[values.dtype.name])
    sequence.frombytes(np.ascontiguousarray(values).view(np.uint8).data)
    return sequence
