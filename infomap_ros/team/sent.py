"""The messages that a robot told lately, so that those which got lost can be told again."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from infomap_ros.team.facts import with_more_facts
from infomap_ros.team.update import MAX_SERIAL


class SentMessages:
    """Numbers messages and keeps the last ones.

    Args:
        serial: number of the message before the first.
        room: for the messages that are kept [bytes].
    """

    def __init__(self, serial: int, room: float) -> None:
        self.serial = serial
        self._room, self._held = room, 0
        self._messages: dict[int, NDArray[np.void]] = {}
        self._asked: set[int] = set()

    def number(self, rows: NDArray[np.void]) -> NDArray[np.void]:
        """The message with its number."""
        self.serial = (self.serial + 1) % MAX_SERIAL
        rows = with_more_facts(rows, {"serial": self.serial})
        self._messages[self.serial] = rows
        self._held += rows.nbytes
        while self._held > self._room and len(self._messages) > 1:
            oldest = next(iter(self._messages))
            self._held -= self._messages.pop(oldest).nbytes
        return rows

    def ask(self, serials: Iterable[int]) -> None:
        """Have messages told again, as far as they are kept."""
        self._asked.update(serial for serial in serials if serial in self._messages)

    def resend(self, room: float) -> list[NDArray[np.void]]:
        """Messages to be told again, oldest first, as many as fit [bytes]."""
        chosen: list[NDArray[np.void]] = []
        for serial in [number for number in self._messages if number in self._asked]:
            rows = self._messages[serial]
            room -= message_bytes(rows)
            if room < 0.0 and chosen:
                return chosen
            self._asked.remove(serial)
            chosen.append(rows)
        self._asked.clear()
        return chosen


def message_bytes(rows: NDArray[np.void]) -> int:
    """Bytes of the message that holds these rows, about."""
    return int(rows.nbytes) + 80 + sum(24 + len(name) for name in rows.dtype.names or ())
