"""Who may write: the team list, and one robot for each id.

A robot draws a session number when it starts. A new number is a robot that has started again; what
it said before may still come late for a while. Where an old session goes on speaking after that,
two robots have the same id, and the old session is refused.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from infomap_ros.errors import UpdateRefusedError
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.versions import COUNT

NOT_LISTED = "not on the team list"
TWO_OF_A_NAME = "two robots with one id"
BACKWARDS = "version goes backwards"
AHEAD = "version far ahead"
_MOST_BEHIND = 32 * 600  # versions; ten minutes at the fastest rate
_MOST_AHEAD = 1 << 24
_KEPT_SESSIONS = 16


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

    def check_session(self, robot: int, session: int, now: float) -> None:
        """Note in which session a robot speaks for itself.

        Raises:
            UpdateRefusedError: another robot has the same id.
        """
        known = self._sessions.setdefault(robot, [session])
        began = self._began.setdefault(robot, now)
        if known[-1] == session:
            return
        if session not in known and robot != self._own:
            self._sessions[robot] = [*known[1 - _KEPT_SESSIONS :], session]
            self._began[robot] = now
            self._newest.pop(robot, None)
        elif now - began > self._grace:
            raise UpdateRefusedError(
                f"two robots call themselves {robot}, in sessions {known[-1]} and {session}",
                TWO_OF_A_NAME,
            )

    def check_update(self, update: MapUpdate, now: float) -> None:
        """Refuse an update that must not be written.

        Raises:
            UpdateRefusedError: its robot or its sender is not on the list, two robots have one
                id, or its version is impossible after those that were heard.
        """
        self.check_robot(update.robot)
        if update.sender is not None:
            self.check_robot(update.sender)
            return
        self.check_session(update.robot, update.session, now)
        if update.session != self._sessions[update.robot][-1]:
            return  # late, from before a restart
        newest = self._newest.get(update.robot, update.version)
        ahead = (update.version - newest + COUNT // 2) % COUNT - COUNT // 2
        if not -_MOST_BEHIND <= ahead <= _MOST_AHEAD:
            reason = BACKWARDS if ahead < 0 else AHEAD
            raise UpdateRefusedError(
                f"robot {update.robot} is at version {newest}, {update.version} is refused", reason
            )
        self._newest[update.robot] = update.version if ahead > 0 else newest


def draw_session() -> int:
    """A number for a session, from the system's randomness."""
    return int(np.random.SeedSequence().generate_state(1)[0])
