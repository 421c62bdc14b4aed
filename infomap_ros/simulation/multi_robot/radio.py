"""A channel between robots that loses packets and takes its time. Only this is simulated."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

PACKET_BYTES, PACKET_OVERHEAD = 1400, 60


@dataclass(frozen=True)
class Radio:
    """The link of each robot to all others.

    Attributes:
        rate: at which a robot can send [bit/s].
        loss: share of the packets that a receiver does not get, independent of each other; a
            message with a lost packet is lost.
        delay: [s].
    """

    rate: float = 10e6
    loss: float = 0.2
    delay: float = 0.02


class Delivery(NamedTuple):
    """A message that has come.

    Attributes:
        receiver: number of the robot.
        kind: of the message, as its sender said.
        content: of the message.
    """

    receiver: int
    kind: str
    content: Any


class Channel:
    """Carries messages of any content between robots.

    Args:
        robots: how many; they have numbers from 0 on.
        radio: how the messages travel.
        rng: source of the losses.
    """

    def __init__(self, robots: int, radio: Radio, rng: np.random.Generator) -> None:
        self.radio, self._rng = radio, rng
        self._free_at, self._count = [0.0] * robots, 0
        self._on_air: list[tuple[float, int, Delivery]] = []

    def send(self, sender: int, kind: str, content: Any, size: int, now: float) -> None:
        """Send a message to all others; it begins when what was sent before is on air.

        Args:
            sender: number of the robot.
            kind: handed on.
            content: handed on.
            size: [bytes].
            now: [s].
        """
        radio, packets = self.radio, -(-size // PACKET_BYTES)
        duration = (size + packets * PACKET_OVERHEAD) * 8.0 / radio.rate
        self._free_at[sender] = max(self._free_at[sender], now) + duration
        for receiver in range(len(self._free_at)):
            arrives = self._rng.random() < (1.0 - radio.loss) ** packets
            if receiver != sender and arrives:
                self._count += 1
                due = self._free_at[sender] + radio.delay
                heapq.heappush(self._on_air, (due, self._count, Delivery(receiver, kind, content)))

    def deliver(self, now: float) -> Iterator[Delivery]:
        """Messages that have come by now [s], in their order."""
        while self._on_air and self._on_air[0][0] <= now:
            yield heapq.heappop(self._on_air)[2]

    def backlog(self, now: float) -> float:
        """How long what was sent still takes to be transmitted, at the most [s]."""
        return max(0.0, max(self._free_at) - now)
