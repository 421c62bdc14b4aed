"""Reads a ROS 1 bag from its beginning, without its index (a recording that was cut off).

Layout from http://wiki.ros.org/Bags/Format/2.0: a first line, then records of header length,
header (fields ``name=value``), data length, data.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import BinaryIO

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.typesys.msg import normalize_msgtype

from infomap_ros.errors import BagError
from infomap_ros.replay.bags.blocks import RawMessage, Salvage, read_exactly
from infomap_ros.replay.bags.source import (
    DAMAGE,
    MOST_CHUNK,
    Channel,
    absolute,
    is_latched_by_custom,
)

_FIRST_LINE = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_DECOMPRESSORS: dict[bytes, Callable[[bytes], bytes]] = {
    b"none": bytes,
    b"bz2": lambda data: bz2.BZ2Decompressor().decompress(data, MOST_CHUNK),
    b"lz4": lambda data: bytes(LZ4FrameDecompressor().decompress(data, MOST_CHUNK)),
}


def salvage_rosbag1(path: Path) -> Salvage:
    """Find everything that is whole in a ROS 1 bag.

    Raises:
        BagError: it is no ROS 1 bag of version 2.0.
    """
    salvage = Salvage(is_ros1=True)
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.readline(64) != _FIRST_LINE:
            raise BagError(f"{path.name} is not a ROS 1 bag of version 2.0")
        while (start := file.tell()) < size:
            try:
                header, offset, length = _file_record(file, size)
            except (struct.error, EOFError, ValueError) as error:
                salvage.problems.append(f"{path.name} is truncated at byte {start}: {error}")
                break
            _take(path, header, offset, file.read(length), salvage)
            if offset + length > size:
                salvage.problems.append(
                    f"{path.name} is truncated: the record at byte {start} needs {length} bytes"
                )
            file.seek(offset + length)
    return salvage


def _file_record(file: BinaryIO, size: int) -> tuple[dict[bytes, bytes], int, int]:
    """Header, and offset and length of the data, of the record at the file's position."""
    (length,) = struct.unpack("<I", file.read(4))
    if file.tell() + length > size:
        raise EOFError(f"its header needs {length} bytes")
    header = _fields(file.read(length))
    (length,) = struct.unpack("<I", file.read(4))
    return header, file.tell(), length


def _fields(data: bytes) -> dict[bytes, bytes]:
    fields, offset = {}, 0
    while offset < len(data):
        (length,) = struct.unpack_from("<I", data, offset)
        name, separator, value = data[offset + 4 : offset + 4 + length].partition(b"=")
        if not separator or offset + 4 + length > len(data):
            raise ValueError("a header field has no value")
        fields[name] = value
        offset += 4 + length
    return fields


def _take(
    path: Path, header: dict[bytes, bytes], offset: int, data: bytes, salvage: Salvage
) -> None:
    """Note one record of the file; `offset` is where its data begin."""
    try:
        if header.get(b"op") == bytes([_CHUNK]):
            compression, messages = header[b"compression"], []
            for fields, content in _chunk_records(compression, data):
                if fields[b"op"] == bytes([_CONNECTION]):
                    _note_connection(fields, content, salvage)
                elif fields[b"op"] == bytes([_MESSAGE]):
                    messages.append(_message(fields, content))
            salvage.add_block(messages, partial(_load_chunk, path, compression, offset, len(data)))
        elif header.get(b"op") == bytes([_CONNECTION]):
            _note_connection(header, data, salvage)
    except (*DAMAGE, OSError) as error:
        salvage.problems.append(f"{path.name}: the record at byte {offset} is damaged: {error}")


def _chunk_records(compression: bytes, data: bytes) -> Iterator[tuple[dict[bytes, bytes], bytes]]:
    """Header and data of the records of a chunk, up to the last that is whole."""
    content, offset = _DECOMPRESSORS[compression](data), 0
    while offset + 4 <= len(content):
        (length,) = struct.unpack_from("<I", content, offset)
        start = offset + 4 + length
        if start + 4 > len(content):
            return
        (size,) = struct.unpack_from("<I", content, start)
        if start + 4 + size > len(content):
            return
        yield _fields(content[offset + 4 : start]), content[start + 4 : start + 4 + size]
        offset = start + 4 + size


def _note_connection(fields: dict[bytes, bytes], content: bytes, salvage: Salvage) -> None:
    (number,) = struct.unpack("<I", fields[b"conn"])
    details = _fields(content)
    topic = absolute(fields[b"topic"].decode())
    salvage.channels[number] = Channel(
        topic=topic,
        type_name=normalize_msgtype(details[b"type"].decode()),
        count=0,
        latched=details.get(b"latching") == b"1" or is_latched_by_custom(topic),
        definition=details[b"message_definition"].decode(),
    )


def _message(fields: dict[bytes, bytes], content: bytes) -> RawMessage:
    (number,) = struct.unpack("<I", fields[b"conn"])
    seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
    return seconds * 1_000_000_000 + nanoseconds, number, content


def _load_chunk(path: Path, compression: bytes, offset: int, size: int) -> list[RawMessage]:
    records = _chunk_records(compression, read_exactly(path, offset, size))
    return [_message(f, c) for f, c in records if f[b"op"] == bytes([_MESSAGE])]
