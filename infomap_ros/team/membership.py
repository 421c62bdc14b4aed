"""Who may write: the team list, and one robot for each id.

A robot draws a session number when it starts. A new number with a newer version is a robot that
has started again; what it said before may still come late, and has older versions. Where an
earlier session goes on with newer versions, two robots have the same id, and it is refused.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol

import numpy as np

from infomap_ros.errors import UpdateRefusedError
from infomap_ros.team.versions import COUNT

NOT_LISTED = "not on the team list"
TWO_OF_A_NAME = "two robots with one id"
BACKWARDS = "version goes backwards"
AHEAD = "version far ahead"
_MOST_BEHIND = 32 * 600  # versions; ten minutes at the fastest rate
_MOST_AHEAD = 1 << 24
_KEPT_SESSIONS = 16


class Told(Protocol):
    """What a robot tells: a map update, or of itself.

    Attributes:
        robot: whose it is.
        session: number that this robot drew when it started.
        version: of what it tells.
        sender: id of the robot that tells it, where that is another one.
    """

    @property
    def robot(self) -> int: ...  # noqa: D102
    @property
    def session(self) -> int: ...  # noqa: D102
    @property
    def version(self) -> int: ...  # noqa: D102
    @property
    def sender(self) -> int | None: ...  # noqa: D102


class Membership:
    """Refuses what must not be written.

    Args:
        robot: id of this robot.
        session: number that it drew when it started; None where it only listens.
        team: ids of the robots that may write; all if empty.
        grace: for how long messages of an earlier session may come late [s].
    """

    def __init__(
        self, robot: int, session: int | None, team: Collection[int] = (), grace: float = 5.0
    ) -> None:
        self._own = None if session is None else robot
        self._team = frozenset(team) | {robot} if team else frozenset()
        self._grace = grace
        self._sessions: dict[int, list[int]] = {} if session is None else {robot: [session]}
        self._began: dict[int, float] = {}
        self._newest: dict[int, int] = {}

    def check_robot(self, robot: int) -> None:
        """Refuse robots that are not on the list.

        Raises:
            UpdateRefusedError: this one is not.
        """
        if self._team and robot not in self._team:
            raise UpdateRefusedError(f"robot {robot} is {NOT_LISTED}", NOT_LISTED)

    def check_update(self, update: Told, now: float, own_version: int) -> None:
        """Refuse an update that must not be written.

        Args:
            update: as it was heard.
            now: time of any steady clock [s].
            own_version: the newest version of this robot.

        Raises:
            UpdateRefusedError: its robot or its sender is not on the list, two robots have one
                id, or its version is impossible after those that were heard.
        """
        self.check_robot(update.robot)
        if update.sender is not None:
            self.check_robot(update.sender)
            return
        newest = self._newest.setdefault(update.robot, update.version)
        newest = own_version if update.robot == self._own else newest
        ahead = (update.version - newest + COUNT // 2) % COUNT - COUNT // 2
        if self._is_current(update, ahead > 0, now):
            if not -_MOST_BEHIND <= ahead <= _MOST_AHEAD:
                reason = BACKWARDS if ahead < 0 else AHEAD
                text = f"robot {update.robot} is at version {newest}, not at {update.version}"
                raise UpdateRefusedError(f"{text}: {reason}", reason)
            self._newest[update.robot] = update.version if ahead > 0 else newest

    def _is_current(self, update: Told, is_newer: bool, now: float) -> bool:
        """Whether an update is of its robot's present session, which may begin with it.

        Raises:
            UpdateRefusedError: an earlier session goes on.
        """
        robot, session = update.robot, update.session
        known = self._sessions.setdefault(robot, [session])
        began = self._began.setdefault(robot, now)
        if known[-1] == session:
            return True
        if not is_newer:
            return False  # late, from before a start
        if session not in known and robot != self._own:
            self._sessions[robot] = [*known[1 - _KEPT_SESSIONS :], session]
            self._began[robot], self._newest[robot] = now, update.version
        elif now - began > self._grace:
            raise UpdateRefusedError(
                f"two robots call themselves {robot}, in sessions {known[-1]} and {session}",
                TWO_OF_A_NAME,
            )
        return False


def draw_session() -> int:
    """A number for a session, from the system's randomness."""
    return int(np.random.SeedSequence().generate_state(1)[0])
