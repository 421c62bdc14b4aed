"""Who may write: the team list, and one robot for each id.

A robot draws a session number when it starts. A new number with a newer version is a robot that
has started again; what it said before may still come late, and has older versions. Where an
earlier session goes on with newer versions, two robots have the same id, and it is refused.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import UpdateRefusedError
from infomap_ros.team.limits import MOST_ROBOTS
from infomap_ros.team.versions import versions_ahead

NOT_LISTED = "not on the team list"
TWO_OF_A_NAME = "two robots with one id"
BACKWARDS = "version goes backwards"
AHEAD = "version far ahead"
TOO_MANY = "too many robots"
TELLS_ITSELF = "is heard itself"
MOST_AHEAD = 1 << 24
"""Versions by which a robot may go on at once: six days at the fastest rate."""
_MOST_BEHIND = 32 * 600  # versions; ten minutes at the fastest rate
_BEYOND_OWN = 1 << 29  # versions of who was never heard; half a year, as `own_version` has it
_KEPT_SESSIONS = 16
_ALIVE = 30.0  # [s] without a word after which a robot may have started with an earlier clock


class Told(Protocol):
    """What a robot tells: a map update, or of itself.

    Attributes:
        robot: whose it is.
        session: number that this robot drew when it started.
        version: of what it tells.
        versions: of all that it tells, shape (K,).
        sender: id of the robot that tells it, where that is another one.
    """

    @property
    def robot(self) -> int: ...  # noqa: D102
    @property
    def session(self) -> int: ...  # noqa: D102
    @property
    def version(self) -> int: ...  # noqa: D102
    @property
    def versions(self) -> NDArray[np.uint32]: ...  # noqa: D102
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
        self._spoke: dict[int, float] = {}
        self._admitted = {robot}

    def may_be_kept(self, robot: int) -> bool:
        """Whether there is room for what is said of a robot."""
        if self._team:
            return robot in self._team
        return robot in self._admitted or len(self._admitted) < MOST_ROBOTS

    def knows(self, robot: int, session: int) -> bool:
        """Whether a robot was heard in a session."""
        return session in self._sessions.get(robot, [])

    def check_robot(self, robot: int) -> None:
        """Refuse robots that are not on the list; without one, those for which there is no room.

        Raises:
            UpdateRefusedError: this one is refused.
        """
        if self._team and robot not in self._team:
            raise UpdateRefusedError(f"robot {robot} is {NOT_LISTED}", NOT_LISTED)
        if not self.may_be_kept(robot):
            text = (
                f"robot {robot} would be one more than {MOST_ROBOTS}; a team list says who counts"
            )
            raise UpdateRefusedError(text, TOO_MANY)
        self._admitted.add(robot)

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
        if update.sender is not None:
            self.check_robot(update.sender)
            self._check_handed_on(update, now, own_version)
            self.check_robot(update.robot)
            return
        self.check_robot(update.robot)
        newest = self._newest.setdefault(update.robot, update.version)
        newest = own_version if update.robot == self._own else newest
        ahead = versions_ahead(update.version, newest)
        if self._is_current(update, ahead, now):
            if not -_MOST_BEHIND <= ahead <= MOST_AHEAD:
                self._refuse(update, newest, BACKWARDS if ahead < 0 else AHEAD)
            self._newest[update.robot] = update.version if ahead > 0 else newest
            self._spoke[update.robot] = now
        if (update.versions != update.version).any():
            self._refuse(update, newest, AHEAD)

    def _check_handed_on(self, update: Told, now: float, own_version: int) -> None:
        """Refuse what others say of a robot that is heard itself, and what it cannot have told.

        Who is silent may have told more than was heard here.
        """
        if update.robot == self._own:
            return
        if now - self._spoke.get(update.robot, -np.inf) < self._grace:
            text = f"robot {update.sender} tells of robot {update.robot}, which {TELLS_ITSELF}"
            raise UpdateRefusedError(text, TELLS_ITSELF)
        newest, most = self._newest.get(update.robot), MOST_AHEAD
        if newest is None:
            newest, most = own_version, _BEYOND_OWN
        if (versions_ahead(update.versions.astype(np.int64), newest) > most).any():
            self._refuse(update, newest, AHEAD)

    def hear_of_itself(self, robot: int, session: int, version: int, now: float) -> None:
        """A robot that goes on in its session says which version it has reached."""
        if self._sessions.get(robot, [None])[-1] != session:
            return
        self._spoke[robot] = now
        if 0 < versions_ahead(version, self._newest[robot]) <= MOST_AHEAD:
            self._newest[robot] = version

    def _refuse(self, update: Told, newest: int, reason: str) -> None:
        text = f"robot {update.robot} is at version {newest}, not at {int(update.versions.max())}"
        raise UpdateRefusedError(f"{text}: {reason}", reason)

    def _is_current(self, update: Told, ahead: int, now: float) -> bool:
        """Whether an update is of its robot's present session, which may begin with it.

        Raises:
            UpdateRefusedError: an earlier session goes on, or is heard of for the first time long
                after the present one, which is alive, has begun: somebody replays it.
        """
        robot, session = update.robot, update.session
        known = self._sessions.setdefault(robot, [session])
        began = self._began.setdefault(robot, now)
        if known[-1] == session:
            return True
        if ahead <= 0:  # late, from before a start
            is_alive = robot != self._own and now - self._spoke.get(robot, -np.inf) < _ALIVE
            is_late = now - began > self._grace or ahead < -_MOST_BEHIND
            if ahead < 0 and is_alive and is_late and session not in known:
                self._refuse(update, self._newest[robot], BACKWARDS)
            return False
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
