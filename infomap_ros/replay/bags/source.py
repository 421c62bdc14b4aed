"""Where the raw messages of a bag come from, whatever its format."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import apsw
from backports import zstd
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag1,
    MessageDefinitionFormat,
    QosDurability,
)
from rosbags.rosbag1 import ReaderError as Rosbag1Error
from rosbags.rosbag2 import ReaderError as Rosbag2Error
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

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

    def messages(self, topics: Collection[str]) -> Iterator[tuple[Channel, int, bytes]]:
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

    def messages(self, topics: Collection[str]) -> Iterator[tuple[Channel, int, bytes]]:
        """See `BagSource.messages`."""
        wanted = [c for c in self._reader.connections if absolute(c.topic) in topics]
        if wanted:
            for connection, stamp, data in self._reader.messages(connections=wanted):
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
        told = bool(connection.ext.latching)
    else:
        profiles = connection.ext.offered_qos_profiles
        told = any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in profiles)
    return told or is_latched_by_custom(connection.topic)


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
