"""The messages that a robot told lately, so that those which got lost can be told again."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from infomap_ros.team.message_header import with_header_values
from infomap_ros.team.update import MAX_SERIAL


class SentMessages:
    """Numbers messages and keeps the last ones.

    Args:
        serial: number of the message before the first.
        room: for the messages that are kept [bytes].
        request_timeout: for so long after a message was told again, it is on its way [s].
    """

    def __init__(self, serial: int, room: float, request_timeout: float) -> None:
        self.serial = serial
        self._room, self._held, self._request_timeout = room, 0, request_timeout
        self._told_again: dict[int, float] = {}
        self._messages: dict[int, NDArray[np.void]] = {}
        self._asked: set[int] = set()

    def number(self, rows: NDArray[np.void]) -> NDArray[np.void]:
        """The message with its number."""
        self.serial = (self.serial + 1) % MAX_SERIAL
        rows = with_header_values(rows, {"serial": self.serial})
        self._messages[self.serial] = rows
        self._held += rows.nbytes
        while self._held > self._room and len(self._messages) > 1:
            oldest = next(iter(self._messages))
            self._held -= self._messages.pop(oldest).nbytes
            self._told_again.pop(oldest, None)
        return rows

    def ask(self, serials: Iterable[int], now: float) -> None:
        """Have messages told again, as far as they are kept and not on their way."""
        for serial in serials:
            since = now - self._told_again.get(serial, -np.inf)
            if serial in self._messages and since >= self._request_timeout:
                self._asked.add(serial)

    def resend(self, room: float, now: float) -> list[NDArray[np.void]]:
        """Messages to be told again, oldest first, as many as fit [bytes].

        What was told again before and is still missed is told twice.
        """
        chosen: list[NDArray[np.void]] = []
        for serial in [number for number in self._messages if number in self._asked]:
            copies = [self._messages[serial]] * (2 if serial in self._told_again else 1)
            room -= sum(map(message_bytes, copies))
            if room < 0.0 and chosen:
                return chosen
            self._asked.remove(serial)
            self._told_again[serial] = now
            chosen += copies
        self._asked.clear()
        return chosen


def message_bytes(rows: NDArray[np.void]) -> int:
    """Bytes of the message that holds these rows, about."""
    return int(rows.nbytes) + 80 + sum(24 + len(name) for name in rows.dtype.names or ())
