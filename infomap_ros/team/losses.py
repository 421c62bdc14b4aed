"""Which messages of others were lost: gaps in their serial numbers."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

_WINDOW = 2000  # messages; a larger gap is a robot that has started again, or a long silence


@dataclass
class _Loss:
    """When a loss was noticed, and when the message was asked for."""

    noticed: float
    asked: float = -np.inf


class Losses:
    """Keeps account of the messages of each robot.

    Args:
        request_timeout: time until a message is asked for again [s].
        give_up: time until it is not asked for any more [s].
    """

    def __init__(self, request_timeout: float, give_up: float) -> None:
        self._request_timeout, self._give_up = request_timeout, give_up
        self._newest: dict[int, int] = {}
        self._lost: dict[int, dict[int, _Loss]] = {}

    def hear(self, robot: int, serial: int, now: float) -> None:
        """A message with this number has come."""
        self.expect(robot, serial, now)
        self._lost.get(robot, {}).pop(serial, None)

    def expect(self, robot: int, serial: int, now: float) -> None:
        """A robot says that this is the number of its last message."""
        newest = self._newest.get(robot)
        if newest is None or abs(serial - newest) > _WINDOW:
            self._newest[robot] = serial
            self._lost[robot] = {}
            return
        lost = self._lost[robot]
        for number in range(newest + 1, serial + 1):
            lost[number] = _Loss(now)
        for number in list(islice(lost, max(0, len(lost) - _WINDOW))):
            del lost[number]
        self._newest[robot] = max(newest, serial)

    def asked(self, robot: int, serials: NDArray[np.int32], now: float) -> None:
        """Another robot has asked for messages of a robot: the answer goes to all.

        That counts once for each message, so that who always asks keeps nobody else from it.
        """
        lost = self._lost.get(robot, {})
        for serial in serials.tolist():
            if serial in lost and lost[serial].asked == -np.inf:
                lost[serial].asked = now

    def to_ask(self, now: float) -> dict[int, NDArray[np.int32]]:
        """Numbers of the messages to be asked for now, for each robot; they count as asked for."""
        wanted = {}
        for robot, lost in self._lost.items():
            for serial in [n for n, loss in lost.items() if now - loss.noticed > self._give_up]:
                del lost[serial]
            due = [n for n, loss in lost.items() if now - loss.asked >= self._request_timeout]
            if due:
                wanted[robot] = np.array(due, np.int32)
                for number in due:
                    lost[number].asked = now
        return wanted
