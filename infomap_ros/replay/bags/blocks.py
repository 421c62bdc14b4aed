"""What can be saved of a damaged bag: its channels and the blocks that are whole."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from infomap_ros.replay.bags.source import EVER, Channel, RawMessages

RawMessage = tuple[int, int, bytes]
"""Receive time [ns], number of the channel, serialized message."""


@dataclass(frozen=True)
class Block:
    """Messages that are read together.

    Attributes:
        start: receive time of the first [ns].
        load: reads them.
    """

    start: int
    load: Callable[[], list[RawMessage]]


@dataclass
class Salvage:
    """What one file gave.

    Attributes:
        channels: by number.
        blocks: the parts that are whole.
        counts: messages per channel number.
        problems: what is damaged, in sentences.
        start: receive time of the first message [ns].
        end: receive time of the last message [ns].
        is_ros1: True for the serialization of ROS 1.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    blocks: list[Block] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    start: int = 2**63 - 1
    end: int = 0
    is_ros1: bool = False

    def add_block(self, messages: list[RawMessage], load: Callable[[], list[RawMessage]]) -> None:
        """Take note of a block that was read whole."""
        if not messages:
            return
        stamps = [stamp for stamp, _, _ in messages]
        self.blocks.append(Block(min(stamps), load))
        self.start, self.end = min(self.start, *stamps), max(self.end, *stamps)
        for _, channel, _ in messages:
            self.counts[channel] = self.counts.get(channel, 0) + 1


def in_time_order(blocks: Collection[Block]) -> Iterator[RawMessage]:
    """All messages of the blocks in order of time; a block is loaded when its time has come."""
    waiting = sorted(blocks, key=lambda block: block.start, reverse=True)
    heap: list[tuple[int, int, RawMessage]] = []
    number = 0
    while waiting or heap:
        while waiting and (not heap or waiting[-1].start <= heap[0][0]):
            for message in waiting.pop().load():
                heapq.heappush(heap, (message[0], number, message))
                number += 1
        yield heapq.heappop(heap)[2]


class SalvagedSource:
    """A damaged bag, as far as it is whole; see `BagSource`."""

    def __init__(self, parts: list[Salvage], cleanup: Callable[[], None]) -> None:
        self.problems = [problem for part in parts for problem in part.problems]
        self.is_ros1 = any(part.is_ros1 for part in parts)
        self.start = min((part.start for part in parts), default=2**63 - 1)
        self.end = max((part.end for part in parts), default=0)
        self._cleanup = cleanup
        self._blocks: list[Block] = []
        self._channels: dict[tuple[int, int], Channel] = {}
        self.channels: list[Channel] = []
        for index, part in enumerate(parts):
            for number, channel in part.channels.items():
                counted = replace(channel, count=part.counts.get(number, 0))
                self._channels[index, number] = counted
                self.channels.append(counted)
        self._parts = parts

    def messages(self, topics: Collection[str], between: range = EVER) -> RawMessages:
        """See `BagSource.messages`."""
        streams = [self._part_messages(index, topics) for index in range(len(self._parts))]
        for message in heapq.merge(*streams, key=lambda message: message[1]):
            if message[1] in between:
                yield message

    def _part_messages(self, index: int, topics: Collection[str]) -> RawMessages:
        for stamp, number, data in in_time_order(self._parts[index].blocks):
            channel = self._channels.get((index, number))
            if channel is not None and channel.topic in topics:
                yield channel, stamp, data

    def close(self) -> None:
        """See `BagSource.close`."""
        self._cleanup()


def read_exactly(path: Path, offset: int, size: int) -> bytes:
    """`size` bytes at `offset` of a file.

    Raises:
        EOFError: the file ends before.
    """
    with path.open("rb") as file:
        file.seek(offset)
        data = file.read(size)
    if len(data) != size:
        raise EOFError(f"{path.name} ends at byte {offset + len(data)}")
    return data
