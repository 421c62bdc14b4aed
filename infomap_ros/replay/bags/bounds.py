"""What a bag may make a reader allocate or do, whatever it says of itself."""

from __future__ import annotations

import mmap
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path

from backports import zstd
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.rosbag2 import storage_mcap

from infomap_ros.errors import BagError

_MCAP_START = 8  # bytes of its magic, at both ends
_MCAP_HEADER = struct.Struct("<BQ")  # opcode and length of a record

_ZSTD = b"\x28\xb5\x2f\xfd"  # begins what is packed; CDR begins with a zero

MOST_CHUNK = 1 << 28
"""Content of a chunk [byte]: recorders close one after 1 to 4 MB; one message may be larger."""


def unpacked_chunk(compression: str, packed: bytes, size: int) -> bytes:
    """Unpack a chunk of an MCAP file, to no more than it says that it holds.

    Args:
        compression: ``zstd`` or ``lz4``.
        packed: as it is in the file.
        size: that it states [byte].

    Raises:
        ValueError: it states more than `MOST_CHUNK`, or holds more than it states.
    """
    if size > MOST_CHUNK:
        raise ValueError(f"a chunk is to hold {size} bytes, at most {MOST_CHUNK} are read")
    unpacker = zstd.ZstdDecompressor() if compression == "zstd" else LZ4FrameDecompressor()
    parts, room, given = [], size + 1, packed
    while room and not unpacker.eof:
        part, given = unpacker.decompress(given, max_length=room), b""
        if not part and not unpacker.eof:
            break  # it was cut off
        parts.append(part)
        room -= len(part)
    if not room:
        raise ValueError(f"a chunk holds more than the {size} bytes that it states")
    if unpacker.eof and unpacker.unused_data:
        raise ValueError("a chunk holds something beside its content")
    return b"".join(parts)


def unpacked_cdr(data: bytes) -> bytes:
    """A message as CDR: rosbag2 may pack each by itself, which only its metadata.yaml tells."""
    return unpacked_chunk("zstd", data, MOST_CHUNK) if data[:4] == _ZSTD else data


def bound_rosbags() -> None:
    """Have rosbags unpack chunks by `unpacked_chunk`: its own way stops at no size."""
    for compression in ("zstd", "lz4"):
        storage_mcap.DECOMPRESSORS[compression] = _bounded(compression)


def _bounded(compression: str) -> Callable[[bytes, int], bytes]:
    return lambda packed, size: unpacked_chunk(compression, packed, size)


def check_lengths(path: Path) -> None:
    """Walk through the records of an MCAP file: rosbags allocates what they say they need.

    Raises:
        ValueError: one is longer than the file.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        if size < _MCAP_START:
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            at = _MCAP_START
            while at + _MCAP_HEADER.size <= size:
                length = _MCAP_HEADER.unpack_from(content, at)[1]
                if at + _MCAP_HEADER.size + length > size:
                    raise ValueError(f"the record at byte {at} needs {length} bytes")
                at += _MCAP_HEADER.size + length


def check_tables(path: Path) -> None:
    """Refuse a SQLite file that has views or triggers: reading them may never end.

    A file that cannot be read at all is left to who reads it next.

    Raises:
        BagError: it has some; a recorder makes none.
    """
    database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    try:
        query = "SELECT name FROM sqlite_master WHERE type IN ('view', 'trigger') LIMIT 1"
        found = database.execute(query).fetchone()
    except (sqlite3.Error, ValueError):
        found = None
    finally:
        database.close()
    if found:
        raise BagError(f"{path.name} is no recorded bag: its '{found[0]}' is computed, not stored")
