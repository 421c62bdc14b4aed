"""Where the raw messages of a bag come from, whatever its format.

What a bag may make a reader allocate or do, whatever it says of itself.
"""

from __future__ import annotations

import contextlib
import mmap
import sqlite3
import struct
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import apsw
from backports import zstd
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag1,
    MessageDefinitionFormat,
    QosDurability,
)
from rosbags.rosbag1 import ReaderError as Rosbag1Error
from rosbags.rosbag2 import ReaderError as Rosbag2Error
from rosbags.rosbag2 import storage_mcap
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from infomap_ros.errors import BagError

LATCHED_BY_CUSTOM = ("tf_static", "robot_description", "map")

# What the readers and their decompressors raise on content that is damaged. They check only what
# they expect to go wrong, so a damaged length or name shows as any of these.
DAMAGE = (
    AnyReaderError,
    AssertionError,
    EOFError,
    IndexError,
    KeyError,
    MemoryError,
    OverflowError,
    Rosbag1Error,
    Rosbag2Error,
    RuntimeError,
    SerdeError,
    TypeError,
    TypesysError,
    ValueError,
    apsw.Error,
    struct.error,
    zstd.ZstdError,
)

EVER = range(2**63 - 1)
"""All receive times [ns]."""


@dataclass(frozen=True)
class Channel:
    """A stream of messages in a bag.

    Attributes:
        topic: absolute name.
        type_name: ROS 2 form, for example ``sensor_msgs/msg/Image``.
        count: number of messages.
        latched: True where a late subscriber gets the last message.
        definition: text of the type's definition, empty where the bag holds none.
        is_idl: True where `definition` is IDL and not msg.
    """

    topic: str
    type_name: str
    count: int
    latched: bool = False
    definition: str = ""
    is_idl: bool = False

    def __post_init__(self) -> None:
        package, _, name = self.type_name.partition("/")
        if name and "/" not in name:  # as some writers have it
            object.__setattr__(self, "type_name", f"{package}/msg/{name}")


RawMessages = Iterator[tuple[Channel, int, bytes]]


class BagSource(Protocol):
    """Raw messages in order of time.

    Attributes:
        channels: what the bag holds.
        is_ros1: True where messages are serialized as in ROS 1, False for CDR.
        start: receive time of the first message [ns].
        end: receive time of the last message [ns].
        problems: what is damaged, one sentence each; grows while reading.
    """

    channels: list[Channel]
    is_ros1: bool
    start: int
    end: int
    problems: list[str]

    def messages(self, topics: Collection[str], between: range = EVER) -> RawMessages:
        """Channel, receive time [ns] and serialized message of every message on `topics`."""

    def close(self) -> None:
        """Release the files."""


def absolute(topic: str) -> str:
    """The absolute name of a topic: ROS 1 bags may leave out the first slash."""
    return topic if topic.startswith("/") else f"/{topic}"


class RosbagsSource:
    """A bag that is whole, read by rosbags; see `BagSource`."""

    def __init__(self, path: Path) -> None:
        """Open a bag.

        Args:
            path: rosbag2 folder, ``.mcap``, ``.db3`` or ROS 1 ``.bag`` file.

        Raises:
            OSError: the file cannot be opened.
            Exception: one of `DAMAGE` when the bag is damaged.
        """
        store = get_typestore(Stores.ROS2_JAZZY)
        self._reader = AnyReader([path], default_typestore=store)
        self._reader.open()
        _match_by_topic(self._reader)
        self.is_ros1 = not self._reader.is2
        self.start, self.end = self._reader.start_time, self._reader.end_time - 1
        self.problems: list[str] = []
        self._channels = {
            (id(connection.owner), connection.id): _channel(connection)
            for connection in self._reader.connections
        }
        self.channels = list(self._channels.values())

    def messages(self, topics: Collection[str], between: range = EVER) -> RawMessages:
        """See `BagSource.messages`."""
        wanted = [c for c in self._reader.connections if absolute(c.topic) in topics]
        if wanted:
            times = between.start, between.stop
            for connection, stamp, data in self._reader.messages(wanted, *times):
                yield self._channels[id(connection.owner), connection.id], stamp, data

    def close(self) -> None:
        """See `BagSource.close`."""
        self._reader.close()


def _match_by_topic(reader: AnyReader) -> None:
    """Let what metadata.yaml states of a topic hold for the files too, for example its QoS.

    Where the two differ in anything, rosbags gives no message of that topic and no error.
    """
    for part in reader.readers:
        for storage in getattr(getattr(part, "storage", None), "storages", ()):
            for index, own in enumerate(storage.connections):
                stated = [c for c in part.connections if c.topic == own.topic]
                said = min(stated, key=lambda c: c.msgtype != own.msgtype, default=own)
                storage.connections[index] = own._replace(
                    msgtype=said.msgtype, ext=said.ext, digest=said.digest
                )


def _channel(connection: Connection) -> Channel:
    definition = connection.msgdef
    return Channel(
        topic=absolute(connection.topic),
        type_name=connection.msgtype,
        count=connection.msgcount,
        latched=_is_latched(connection),
        definition=definition.data if definition.format != MessageDefinitionFormat.NONE else "",
        is_idl=definition.format == MessageDefinitionFormat.IDL,
    )


def _is_latched(connection: Connection) -> bool:
    if isinstance(connection.ext, ConnectionExtRosbag1):
        latched = bool(connection.ext.latching)
    else:
        profiles = connection.ext.offered_qos_profiles
        latched = any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in profiles)
    return latched or is_latched_by_custom(connection.topic)


def is_latched_by_custom(topic: str) -> bool:
    """True for topics that are latched wherever they occur, for bags that do not say."""
    return topic.rsplit("/", 1)[-1] in LATCHED_BY_CUSTOM


def typestore_of(channels: Collection[Channel], omit: Collection[str] = ()) -> Typestore:
    """The message types that the channels use.

    Definitions come from the bag; where it holds none that can be read, from ROS 2 Jazzy.

    Args:
        channels: with their definitions.
        omit: names of types whose definition in the bag is not used.
    """
    types: dict[str, Any] = {}
    for channel in channels:
        with contextlib.suppress(*DAMAGE):
            types.update(_types_of(channel))
    store = get_typestore(Stores.EMPTY)
    store.register({name: fields for name, fields in types.items() if name not in omit})
    known = get_typestore(Stores.ROS2_JAZZY).fielddefs
    store.register({name: fields for name, fields in known.items() if name not in store.fielddefs})
    return store


def _types_of(channel: Channel) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if channel.is_idl:
        for text in _idl_files(channel.definition):
            found.update(get_types_from_idl(text))
    elif channel.definition:
        found.update(get_types_from_msg(channel.definition, channel.type_name))
    return found


def _idl_files(definition: str) -> list[str]:
    separator = "=" * 80 + "\n"
    if not definition.startswith(f"{separator}IDL: "):
        return [definition]
    return [part.split("\n", 1)[1] for part in definition.split(separator)[1:]]


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
