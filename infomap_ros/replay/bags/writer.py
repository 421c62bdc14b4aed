"""Records into a rosbag2 (MCAP, compressed)."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    StoragePlugin,
    Writer,
    WriterError,
)
from rosbags.typesys import Stores, get_typestore

from infomap_ros.errors import BagError, InvalidInputError
from infomap_ros.geometry.records import Record, TransformRecord
from infomap_ros.messages import (
    TF,
    RosbagsMessageTypes,
    encode,
    encode_transforms,
    message_type_of,
)
from infomap_ros.replay.bags.source import is_latched_by_custom

_STORAGES = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}


class BagWriter:
    """Writes a rosbag2 that any ROS 2 tool can read; use it as a context manager.

    A ``with`` block that ends with an error leaves no bag.
    """

    def __init__(self, path: Path | str, *, storage: str = "mcap", overwrite: bool = False) -> None:
        """Create the bag's folder.

        Args:
            path: folder to create.
            storage: ``mcap`` (chunks compressed with zstd) or ``sqlite3``.
            overwrite: replace a bag that is there already.

        Raises:
            BagError: something is there already, or it cannot be created.
            InvalidInputError: the storage is not known.
        """
        if storage not in _STORAGES:
            raise InvalidInputError("storage", f"'{storage}', expected mcap or sqlite3")
        self.path = Path(path)
        if overwrite and self.path.is_dir() and _holds_only_a_bag(self.path):
            shutil.rmtree(self.path)
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._types = RosbagsMessageTypes(self._store)
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = Writer(self.path, version=9, storage_plugin=_STORAGES[storage])
            if storage == "mcap":
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except (WriterError, OSError) as error:
            if self.path.exists():
                raise BagError(
                    f"cannot write a bag to {self.path}: something is there already; --overwrite "
                    "replaces a bag"
                ) from error
            raise BagError(f"cannot write a bag to {self.path}: {error}") from error

    def write(self, topic: str, record: Record, received: int | None = None) -> None:
        """Write one record.

        Args:
            topic: absolute name.
            record: its content.
            received: receive time [ns]; the record's own stamp where not given.

        Raises:
            InvalidInputError: the record contradicts itself, or the topic has another type.
        """
        stamp = record.stamp if received is None else received
        self._write(topic, message_type_of(record), encode(self._types, record), stamp)

    def write_transforms(
        self, topic: str, records: Sequence[TransformRecord], received: int | None = None
    ) -> None:
        """Write several transforms as one message; arguments as in `write`.

        Raises:
            InvalidInputError: there are none.
        """
        if not records:
            raise InvalidInputError("records", "is empty")
        stamp = records[0].stamp if received is None else received
        self._write(topic, TF, encode_transforms(self._types, records), stamp)

    def _write(self, topic: str, type_name: str, message: Any, stamp: int) -> None:
        connection = self._connections.get(topic)
        if connection is None:
            qos = [_LATCHED] if is_latched_by_custom(topic) else []
            connection = self._writer.add_connection(
                topic, type_name, typestore=self._store, offered_qos_profiles=qos
            )
            self._connections[topic] = connection
        if connection.msgtype != type_name:
            raise InvalidInputError(
                f"topic {topic}", f"has type {connection.msgtype}, not {type_name}"
            )
        data = self._store.serialize_cdr(message, type_name)
        self._writer.write(connection, stamp, data)

    def close(self) -> None:
        """Write index and metadata."""
        self._writer.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self._writer.abort()
            shutil.rmtree(self.path, ignore_errors=True)


def _holds_only_a_bag(folder: Path) -> bool:
    return all(f.suffix in (".mcap", ".db3", ".yaml") for f in folder.iterdir())


_LATCHED = Qos(
    history=QosHistory.KEEP_LAST,
    depth=1,
    reliability=QosReliability.RELIABLE,
    durability=QosDurability.TRANSIENT_LOCAL,
    deadline=QosTime(sec=2147483647, nsec=4294967295),
    lifespan=QosTime(sec=2147483647, nsec=4294967295),
    liveliness=QosLiveliness.AUTOMATIC,
    liveliness_lease_duration=QosTime(sec=2147483647, nsec=4294967295),
    avoid_ros_namespace_conventions=False,
)
