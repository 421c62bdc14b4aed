"""What can be read of a serialized message without its type."""

from __future__ import annotations

import struct

from infomap_ros.errors import MalformedMessageError

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
