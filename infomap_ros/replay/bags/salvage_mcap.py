"""Reads an MCAP file from its beginning, without the index at its end.

Layout from https://mcap.dev/spec: magic, then records of opcode (1 byte), length (8 bytes, little
endian) and content. Chunks hold schemas, channels and messages, compressed. Schemas and channels
are there again after the last chunk, which helps where a chunk is damaged.
"""

from __future__ import annotations

import struct
from binascii import crc32
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from infomap_ros.errors import BagError
from infomap_ros.replay.bags.blocks import RawMessage, Salvage, read_exactly
from infomap_ros.replay.bags.source import (
    DAMAGE,
    Channel,
    absolute,
    is_latched_by_custom,
    unpacked_chunk,
)

_MAGIC = b"\x89MCAP0\r\n"
_HEADER = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
_MESSAGE = struct.Struct("<HIQQ")
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE_OP, _CHUNK_OP = 2, 3, 4, 5, 6


def salvage_mcap(path: Path) -> Salvage:
    """Find everything that is whole in an MCAP file.

    Raises:
        BagError: it is no MCAP file.
    """
    salvage = Salvage()
    size = path.stat().st_size
    schemas: dict[int, tuple[str, str, str]] = {}
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise BagError(f"{path.name} is not an MCAP file: it does not begin like one")
        while True:
            start = file.tell()
            header = file.read(_HEADER.size)
            if len(header) < _HEADER.size:
                salvage.problems.append(
                    f"{path.name} is truncated at byte {size}: it has no footer"
                )
                return salvage
            opcode, length = _HEADER.unpack(header)
            if opcode == _FOOTER:
                return salvage
            offset = start + _HEADER.size
            is_cut = offset + length > size
            if is_cut:
                salvage.problems.append(
                    f"{path.name} is truncated: the record at byte {start} needs {length} bytes"
                )
            if opcode == _CHUNK_OP or (opcode in (_SCHEMA, _CHANNEL, _MESSAGE_OP) and not is_cut):
                _take(path, opcode, offset, file.read(min(length, size)), salvage, schemas)
            if is_cut:
                return salvage
            file.seek(offset + length)


def _take(
    path: Path,
    opcode: int,
    offset: int,
    content: bytes,
    salvage: Salvage,
    schemas: dict[int, tuple[str, str, str]],
) -> None:
    """Note one record of the file; `offset` is where its content begins."""
    try:
        if opcode == _CHUNK_OP:
            inner = _chunk_content(content)
            messages = [m for m in (_note(*r, salvage, schemas) for r in _records(inner)) if m]
            salvage.add_block(messages, partial(_load_chunk, path, offset, len(content)))
        elif message := _note(opcode, content, salvage, schemas):
            salvage.add_block([message], partial(_load_message, path, offset, len(content)))
    except DAMAGE as error:
        salvage.problems.append(f"{path.name}: the record at byte {offset} is damaged: {error}")


def _note(
    opcode: int, content: bytes, salvage: Salvage, schemas: dict[int, tuple[str, str, str]]
) -> RawMessage | None:
    if opcode == _SCHEMA:
        (number,) = struct.unpack_from("<H", content)
        name, encoding, text, _ = _strings(content, 2, 3)
        schemas[number] = (name, encoding, text)
    elif opcode == _CHANNEL:
        number, schema = struct.unpack_from("<HH", content)
        topic, _, tail = _strings(content, 4, 2)
        name, encoding, text = schemas.get(schema, ("unknown", "", ""))
        latched = b"durability: transient_local" in tail or is_latched_by_custom(topic)
        is_idl = encoding in ("ros2idl", "omgidl")
        salvage.channels[number] = Channel(absolute(topic), name, 0, latched, text, is_idl)
    elif opcode == _MESSAGE_OP:
        number, _, stamp, _ = _MESSAGE.unpack_from(content)
        return stamp, number, content[_MESSAGE.size :]
    return None


def _strings(content: bytes, offset: int, count: int) -> tuple:  # type: ignore[type-arg]
    """`count` strings with their lengths before them, then what follows as bytes."""
    found: list[str | bytes] = []
    for _ in range(count):
        (length,) = struct.unpack_from("<I", content, offset)
        end = offset + 4 + length
        if end > len(content):
            raise EOFError("a text leaves its record")
        found.append(content[offset + 4 : end].decode())
        offset = end
    return (*found, content[offset:])


def _chunk_content(content: bytes) -> bytes:
    """What a chunk holds; of one that was cut off, as much as is there.

    Raises:
        ValueError: it is all there but not what its size and checksum say.
    """
    _, _, size, checksum = _CHUNK.unpack_from(content)
    compression, tail = _strings(content, _CHUNK.size, 1)
    (packed_size,) = struct.unpack_from("<Q", tail)
    packed = tail[8 : 8 + packed_size]
    if compression in ("zstd", "lz4"):
        inner = unpacked_chunk(compression, packed, size)
    elif compression == "":
        inner = packed
    else:
        raise ValueError(f"compression '{compression}' is not known")
    is_whole = len(packed) == packed_size
    if is_whole and (len(inner) != size or (checksum and crc32(inner) != checksum)):
        raise ValueError("chunk does not have the size and checksum that it states")
    return bytes(inner)


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of the records of a chunk, up to the last that is whole."""
    offset = 0
    while offset + _HEADER.size <= len(content):
        opcode, length = _HEADER.unpack_from(content, offset)
        offset += _HEADER.size
        if offset + length > len(content):
            return
        yield opcode, content[offset : offset + length]
        offset += length


def _load_chunk(path: Path, offset: int, size: int) -> list[RawMessage]:
    inner = _chunk_content(read_exactly(path, offset, size))
    return [_message(content) for opcode, content in _records(inner) if opcode == _MESSAGE_OP]


def _load_message(path: Path, offset: int, size: int) -> list[RawMessage]:
    return [_message(read_exactly(path, offset, size))]


def _message(content: bytes) -> RawMessage:
    number, _, stamp, _ = _MESSAGE.unpack_from(content)
    return stamp, number, content[_MESSAGE.size :]
