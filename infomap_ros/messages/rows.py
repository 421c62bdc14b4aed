"""Structured numpy arrays as point clouds: self-describing rows of any fields."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.messages.clouds import POINT_CLOUD, POINT_FIELD
from infomap_ros.messages.fields import MessageFields, MessageTypes, make_header

_CODE_OF_TYPE = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
_MAX_COUNT = 4096
_TYPE_OF_CODE = {code: name for name, code in _CODE_OF_TYPE.items()}


def encode_rows(types: MessageTypes, stamp: int, frame_id: str, rows: NDArray[np.void]) -> Any:
    """Build a ``sensor_msgs/PointCloud2`` with one point per row.

    Args:
        types: who makes the message.
        stamp: [ns].
        frame_id: frame of the rows' coordinates.
        rows: shape (N,), structured, little endian; its fields, numbers or vectors of numbers,
            become those of the message.

    Raises:
        InvalidInputError: a field has a type that a cloud cannot hold.
    """
    step = rows.dtype.itemsize
    content = np.ascontiguousarray(rows).view(np.uint8).reshape(-1)
    return types.make(
        POINT_CLOUD,
        header=make_header(types, stamp, frame_id),
        height=1,
        width=len(rows),
        fields=_describe(types, rows.dtype),
        is_bigendian=False,
        point_step=step,
        row_step=step * len(rows),
        data=content,
        is_dense=True,
    )


def _describe(types: MessageTypes, dtype: np.dtype[np.void]) -> list[Any]:
    fields = []
    for name, (kind, offset) in ((n, f[:2]) for n, f in (dtype.fields or {}).items()):
        code = _CODE_OF_TYPE.get(kind.base.str[1:])
        if code is None or kind.base.str[0] == ">" or len(kind.shape) > 1:
            raise InvalidInputError("rows", f"field '{name}' of type {kind} does not fit a cloud")
        count = int(math.prod(kind.shape))
        fields.append(types.make(POINT_FIELD, name=name, offset=offset, datatype=code, count=count))
    return fields


def decode_rows(message: object) -> tuple[int, str, NDArray[np.void]]:
    """Read a ``sensor_msgs/PointCloud2`` as rows.

    Args:
        message: the message object.

    Returns:
        Stamp [ns], frame, and rows, shape (N,), with the fields of the message in their order.

    Raises:
        MalformedMessageError: a field is unknown, leaves its point or is there twice, the order
            of bytes is not little endian, or steps and data contradict each other.
    """
    fields = MessageFields(message, POINT_CLOUD)
    stamp, frame_id = fields.header()
    height, width = fields.integer("height"), fields.integer("width")
    step, row_step = fields.integer("point_step"), fields.integer("row_step")
    data, dtype = fields.data(), _layout(fields, step)
    if fields.integer("is_bigendian", high=1):
        fields.fail("rows in big endian order are not read")
    if not step or row_step != width * step or len(data) != row_step * height:
        fields.fail(f"{len(data)} bytes are not {height} x {width} points of {step} bytes")
    return stamp, frame_id, data.view(dtype)


def _layout(fields: MessageFields, step: int) -> np.dtype[np.void]:
    names, kinds, offsets = [], [], []
    for part in fields.children("fields"):
        names.append(part.name("name"))
        offsets.append(part.integer("offset"))
        kind = _TYPE_OF_CODE.get(part.integer("datatype", high=255))
        count = part.integer("count", high=_MAX_COUNT)
        if kind is None:
            fields.fail(f"field '{names[-1]}' is not of a known type")
        kinds.append(f"<{kind}" if count < 2 else f"({count},)<{kind}")
    try:
        return np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": step})
    except (ValueError, TypeError) as error:
        fields.fail(f"its fields do not fit {step} bytes: {error}")
