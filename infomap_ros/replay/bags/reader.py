"""Bags of any format as records in order of time."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from backports import zstd

from infomap_ros.errors import BagError, MalformedMessageError
from infomap_ros.geometry.camera import CameraCalibration
from infomap_ros.geometry.records import CameraInfoRecord, Record
from infomap_ros.messages import DECODABLE_TYPES, decode
from infomap_ros.replay.bags.blocks import Salvage, SalvagedSource
from infomap_ros.replay.bags.salvage_mcap import salvage_mcap
from infomap_ros.replay.bags.salvage_rosbag1 import salvage_rosbag1
from infomap_ros.replay.bags.salvage_sqlite import salvage_sqlite, stated_size
from infomap_ros.replay.bags.source import (
    DAMAGE,
    EVER,
    BagSource,
    Channel,
    RawMessages,
    RosbagsSource,
    bound_rosbags,
    check_lengths,
    check_tables,
    typestore_of,
    unpacked_cdr,
)

bound_rosbags()

# Old ROS 1 bags have tf under this name; the content is the same.
_RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


@dataclass(frozen=True)
class BagMessage:
    """One message as it is in the bag.

    Attributes:
        topic: absolute name.
        type_name: ROS 2 form.
        stamp: when it was received [ns].
        data: serialized as CDR (those of ROS 1 bags are converted).
    """

    topic: str
    type_name: str
    stamp: int
    data: bytes


@dataclass(frozen=True)
class BagRecord:
    """One record with where it came from.

    Attributes:
        topic: absolute name.
        received: when the message was received [ns]; `record.stamp` is when it was measured.
        record: the content.
    """

    topic: str
    received: int
    record: Record


class Recording(AbstractContextManager["Recording"], Protocol):
    """What maps and trajectories are made from: a `BagReader`, or what can be read as one.

    Attributes:
        path: where it is.
        topics: its topics by name.
        start: receive time of the first message [ns].
        end: receive time of the last message [ns].
        problems: what is damaged, in sentences.
        skipped: what could not be read, by reason.
    """

    path: Path
    topics: dict[str, Channel]
    start: int
    end: int
    problems: list[str]
    skipped: Counter[str]

    def records(
        self, topics: Collection[str] | None = None, between: range = EVER
    ) -> Iterator[BagRecord]:
        """Records in order of time; see `BagReader.records`."""


class BagReader:
    """A recorded bag: rosbag2 (folder, ``.mcap`` or ``.db3`` file) or ROS 1 (``.bag``).

    A bag that is truncated or damaged is read as far as it is whole. What is wrong is told in
    `problems`; messages that are there but malformed are counted in `skipped`.

    Attributes:
        path: the bag.
        topics: its topics by name.
        start: receive time of the first message [ns].
        end: receive time of the last message [ns].
        problems: what is damaged, in sentences; grows while reading.
        skipped: malformed messages by reason.
        replaced: calibrations that are given in place of those of the camera infos, by topic.
    """

    def __init__(self, path: Path | str) -> None:
        """Open a bag.

        Raises:
            BagError: there is nothing at `path`, it is no bag, or nothing in it can be read.
        """
        self.path = Path(path)
        self.skipped: Counter[str] = Counter()
        self.problems: list[str] = []
        self._source = self._open()
        self.start, self.end = self._source.start, self._source.end
        self.topics = _by_topic(self._source.channels)
        self._store = typestore_of(self._source.channels)
        self.replaced: dict[str, CameraCalibration] = {}
        self.problems += [
            f"{channel.topic} is left out: the definition of {channel.type_name} cannot be read"
            for channel in self.topics.values()
            if channel.definition and channel.type_name not in self._store.fielddefs
        ]

    def _open(self) -> BagSource:
        if not self.path.exists():
            raise BagError(f"there is no bag at {self.path}")
        if self.path.is_file() and self.path.suffix not in SALVAGERS:
            raise BagError(
                f"{self.path.name} is not a bag: expected a rosbag2 folder or a file ending in "
                f"{', '.join(SALVAGERS)}"
            )
        files = list(self.path.iterdir()) if self.path.is_dir() else [self.path]
        for file in files:
            if file.exists() and not (file.is_file() or file.is_dir()):
                raise BagError(f"{file} is a pipe or device, no bag")
            if file.suffix == ".db3":
                check_tables(file)
        try:
            for file in files:
                if file.suffix == ".mcap":
                    check_lengths(file)
            return RosbagsSource(self.path)
        except OSError as error:
            if not isinstance(error, FileNotFoundError) or not self.path.exists():
                raise BagError(f"{self.path} cannot be opened: {error}") from error
            return self._salvage(error)
        except DAMAGE as error:
            return self._salvage(error)

    def _salvage(self, error: BaseException) -> SalvagedSource:
        """Read the bag without its index, after reading it with its index has failed."""
        source = open_salvage(self.path)
        if not source.channels:
            source.close()
            found = "; ".join(source.problems) or str(error)
            raise BagError(f"nothing in {self.path.name} can be read: {found}") from error
        why = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
        self.problems = source.problems or [f"{self.path.name} is read without its index ({why})"]
        return source

    def messages(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Messages in order of the time at which they were received.

        Args:
            topics: names; all where not given.

        Raises:
            BagError: a topic is not in the bag.
        """
        to_cdr = self._converter()
        for channel, stamp, data in self._raw(topics):
            type_name = _RENAMED.get(channel.type_name, channel.type_name)
            try:
                content = to_cdr(data, channel.type_name)
            except DAMAGE as error:
                self.skipped[f"{channel.topic}: cannot be deserialized ({error})"] += 1
                continue
            yield BagMessage(channel.topic, type_name, stamp, content)

    def _converter(self) -> Callable[[bytes, str], bytes]:
        if not self._source.is_ros1:
            return lambda data, _: unpacked_cdr(data)
        # the header of ROS 1 has one field more, which the conversion leaves out
        store = typestore_of(self._source.channels, omit=["std_msgs/msg/Header"])
        return lambda data, type_name: bytes(store.ros1_to_cdr(data, type_name))

    def records(
        self, topics: Collection[str] | None = None, between: range = EVER
    ) -> Iterator[BagRecord]:
        """Records in order of the time at which their messages were received.

        Args:
            topics: names; where not given, all topics of a type that is read.
            between: receive times [ns].

        Raises:
            BagError: a topic is not in the bag, or is of a type that is not read.
        """
        if topics is None:
            topics = [t.topic for t in self.topics.values() if t.type_name in DECODABLE_TYPES]
        for topic in topics:
            if topic in self.topics and self.topics[topic].type_name not in DECODABLE_TYPES:
                name = self.topics[topic].type_name
                raise BagError(f"topic {topic} has type {name}, which is not read")
        for channel, stamp, data in self._raw(topics, between):
            try:
                for record in self._decode(channel, stamp, data):
                    if isinstance(record, CameraInfoRecord) and channel.topic in self.replaced:
                        record = replace(record, calibration=self.replaced[channel.topic])
                    yield BagRecord(channel.topic, stamp, record)
            except MalformedMessageError as error:
                self.skipped[f"{channel.topic}: {error}"] += 1

    def _decode(self, channel: Channel, stamp: int, data: bytes) -> tuple[Record, ...]:
        name = channel.type_name
        try:
            if self._source.is_ros1:
                message = self._store.deserialize_ros1(data, name)
            else:
                message = self._store.deserialize_cdr(unpacked_cdr(data), name)
        except DAMAGE as error:
            problem = f"cannot be deserialized ({error})"
            raise MalformedMessageError(name, problem) from error
        is_static = channel.topic.endswith("tf_static")
        return decode(name, message, stamp=stamp, is_static=is_static)

    def _raw(self, topics: Collection[str] | None, between: range = EVER) -> RawMessages:
        """Raw messages; where reading by the index fails, the rest without it."""
        wanted = set(self.topics if topics is None else topics)
        if missing := sorted(wanted - self.topics.keys()):
            raise BagError(
                f"{self.path.name} has no topic {', '.join(missing)}; it has "
                f"{', '.join(sorted(self.topics)) or 'none'}"
            )
        last, at_last, count = -1, 0, 0
        try:
            for channel, stamp, data in self._source.messages(wanted, between):
                at_last = at_last + 1 if stamp == last else 1
                last, count = stamp, count + 1
                yield channel, stamp, data
        except DAMAGE as error:
            self.problems.append(f"{self.path.name} is damaged after {last} ns: {error}")
            rest = self._rest(wanted, last, at_last)
            yield from (one for one in rest if one[1] in between)
            return
        promised = sum(self.topics[topic].count for topic in wanted)
        if count < promised and between == EVER:
            found = f"{self.path.name} promises {promised} messages and gives {count}"
            self.problems += [] if found in self.problems else [found]

    def _rest(self, wanted: Collection[str], last: int, at_last: int) -> RawMessages:
        source = open_salvage(self.path)
        self.problems += source.problems
        try:
            for channel, stamp, data in source.messages(wanted):
                at_last -= stamp == last
                if stamp > last or (stamp == last and at_last < 0):
                    yield channel, stamp, data
        finally:
            source.close()

    def close(self) -> None:
        """Release the files."""
        self._source.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _by_topic(channels: Collection[Channel]) -> dict[str, Channel]:
    """One channel a topic, its count summed over those that share the name."""
    topics: dict[str, Channel] = {}
    for channel in channels:
        known = topics.get(channel.topic)
        count = channel.count + (known.count if known else 0)
        latched = channel.latched or (known is not None and known.latched)
        topics[channel.topic] = replace(channel, count=count, latched=latched)
    return topics


_PIECE = 1 << 16

SALVAGERS: dict[str, Callable[[Path], Salvage]] = {
    ".mcap": salvage_mcap,
    ".db3": salvage_sqlite,
    ".bag": salvage_rosbag1,
}


def open_salvage(path: Path) -> SalvagedSource:
    """Open a damaged bag, file by file and without its metadata and index.

    Compressed files, and SQLite files that were cut off, are copied to a temporary folder.

    Raises:
        BagError: none of its files is a bag.
    """
    folder = tempfile.TemporaryDirectory(prefix="infomap_bag_")
    parts, failures = [], []
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        try:
            ready, problems = _prepared(file, Path(folder.name))
            if ready.suffix in SALVAGERS:
                part = SALVAGERS[ready.suffix](ready)
                part.problems[:0] = problems
                parts.append(part)
        except BagError as error:
            failures.append(str(error))
    if not parts:
        folder.cleanup()
        raise BagError("; ".join(failures) or f"{path} holds no bag files")
    parts[0].problems[:0] = failures
    if path.is_dir() and not (path / "metadata.yaml").exists():
        parts[0].problems.insert(0, f"{path.name} has no metadata.yaml")
    return SalvagedSource(parts, folder.cleanup)


def _prepared(file: Path, folder: Path) -> tuple[Path, list[str]]:
    """The file in a form that can be read from its beginning, and what was wrong with it."""
    problems: list[str] = []
    if file.suffix == ".zstd":
        file, problems = _unpacked(file, folder)
    if file.suffix == ".db3" and 0 < file.stat().st_size < (size := stated_size(file)):
        problems.append(f"{file.name} is truncated: it has {file.stat().st_size} of {size} bytes")
        file = _filled(file, folder, size)
    return file, problems


def _unpacked(file: Path, folder: Path) -> tuple[Path, list[str]]:
    """Unpack a compressed file as far as it goes."""
    target = folder / file.stem
    with file.open("rb") as raw, target.open("wb") as out:
        try:
            with zstd.open(raw, "rb") as packed:
                shutil.copyfileobj(packed, out, _PIECE)
        except (EOFError, zstd.ZstdError) as error:
            return target, [f"{file.name} is damaged: {error}"]
    return target, []


def _filled(file: Path, folder: Path, size: int) -> Path:
    """A copy with zeros for what is missing: SQLite refuses a file that is too short."""
    target = folder / f"filled_{file.name}"
    shutil.copyfile(file, target)
    with target.open("r+b") as out:
        out.truncate(size)
    return target
