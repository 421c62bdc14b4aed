"""Which digests and requests are heard for the first time.

Each carries the session of its sender and a number that goes up by one with each of them; so what a
stranger has recorded and repeats is refused, also where it is signed.
"""

from __future__ import annotations

from infomap_ros.errors import UpdateRefusedError

REPEATED = "repeated message"
MAX_NUMBER = 2**62
_WINDOW = 256  # messages; what is late by more is asked for or told again anyway
_KEPT_SESSIONS = 16


class Freshness:
    """Remembers for each robot which numbers were heard."""

    def __init__(self) -> None:
        self._heard: dict[int, dict[int, tuple[int, int]]] = {}

    def check(self, sender: int, session: int, number: int) -> None:
        """Refuse what was heard before, or is late by more than the window.

        Args:
            sender: id of the robot; whoever calls limits how many there are.
            session: number that it drew when it started.
            number: of the message.

        Raises:
            UpdateRefusedError: it is refused.
        """
        sessions = self._heard.setdefault(sender, {})
        newest, seen = sessions.get(session, (number - 1, 0))
        ahead = number - newest
        if ahead <= 0 and (ahead <= -_WINDOW or seen >> -ahead & 1):
            raise UpdateRefusedError(f"robot {sender} has said number {number} before", REPEATED)
        if ahead > 0:
            newest, seen = number, (seen << min(ahead, _WINDOW) | 1) & ((1 << _WINDOW) - 1)
        else:
            seen |= 1 << -ahead
        sessions[session] = newest, seen
        while len(sessions) > _KEPT_SESSIONS:
            del sessions[next(iter(sessions))]
