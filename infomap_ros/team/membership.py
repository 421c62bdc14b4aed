"""Who may write: the team list, and one robot for each id.

A robot draws a session number when it starts. A new number with a newer version is a robot that
has started again; what it said before may still come late, and has older versions. Where an
earlier session goes on with newer versions, two robots have the same id, and it is refused.

Messages that only those can write who know the team's key.

A message carries a code over its rows and header: HMAC with SHA-256 (RFC 2104,
https://doi.org/10.17487/RFC2104), cut to its first 16 bytes. What is repeated by a stranger is
authentic, but old: states that were sent before change nothing.

For a message of rows the code is made from the description of a row and the bytes of the rows. The
description is JSON in ASCII without blanks: a list with one list for each field in the order of the
message (its name, its type as in numpy's array interface, such as ``<f4``, its shape, its offset in
the row [bytes]) and the length of a row [bytes]. For a text it is made from ``text``, a line feed
and the text in UTF-8.
"""

from __future__ import annotations

import hmac
import json
from collections.abc import Collection
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError, UpdateRefusedError
from infomap_ros.team.config import MOST_ROBOTS
from infomap_ros.team.message_header import layout_of, with_header_values, without_last_entry
from infomap_ros.team.update import versions_ahead

NOT_LISTED = "not on the team list"
TWO_OF_A_NAME = "two robots with one id"
BACKWARDS = "version goes backwards"
AHEAD = "version far ahead"
TOO_MANY = "too many robots"
PUBLISHES_ITSELF = "publishes itself"
MOST_AHEAD = 1 << 24
"""Versions by which a robot may go on at once: six days at the fastest rate."""
_MOST_BEHIND = 32 * 600  # versions; ten minutes at the fastest rate
_BEYOND_OWN = 1 << 29  # versions of who has never sent; half a year, as `own_version` has it
_KEPT_SESSIONS = 16
_ALIVE = 30.0  # [s] without a word after which a robot may have started with an earlier clock


class TeamMessage(Protocol):
    """What a robot sends: a map update, or a report of itself.

    Attributes:
        robot: whose it is.
        session: number that this robot drew when it started.
        version: of what it sends.
        versions: of all that it sends, shape (K,).
        sender: id of the robot that sends it, where that is another one.
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
        """Whether a robot has sent in a session."""
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

    def check_update(self, update: TeamMessage, now: float, own_version: int) -> None:
        """Refuse an update that must not be written.

        Args:
            update: as it was received.
            now: time of any steady clock [s].
            own_version: the newest version of this robot.

        Raises:
            UpdateRefusedError: its robot or its sender is not on the list, two robots have one
                id, or its version is impossible after those that were received.
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

    def _check_handed_on(self, update: TeamMessage, now: float, own_version: int) -> None:
        """Refuse what others say of a robot that publishes itself, and what it cannot have sent.

        Who is silent may have sent more than was received here.
        """
        if update.robot == self._own:
            return
        if now - self._spoke.get(update.robot, -np.inf) < self._grace:
            text = f"robot {update.sender} reports robot {update.robot}, which {PUBLISHES_ITSELF}"
            raise UpdateRefusedError(text, PUBLISHES_ITSELF)
        newest, most = self._newest.get(update.robot), MOST_AHEAD
        if newest is None:
            newest, most = own_version, _BEYOND_OWN
        if (versions_ahead(update.versions.astype(np.int64), newest) > most).any():
            self._refuse(update, newest, AHEAD)

    def note_version(self, robot: int, session: int, version: int, now: float) -> None:
        """A robot that goes on in its session says which version it has reached."""
        if self._sessions.get(robot, [None])[-1] != session:
            return
        self._spoke[robot] = now
        if 0 < versions_ahead(version, self._newest[robot]) <= MOST_AHEAD:
            self._newest[robot] = version

    def _refuse(self, update: TeamMessage, newest: int, reason: str) -> None:
        text = f"robot {update.robot} is at version {newest}, not at {int(update.versions.max())}"
        raise UpdateRefusedError(f"{text}: {reason}", reason)

    def _is_current(self, update: TeamMessage, ahead: int, now: float) -> bool:
        """Whether an update is of its robot's present session, which may begin with it.

        Raises:
            UpdateRefusedError: an earlier session goes on, or is seen for the first time long
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


NOT_AUTHENTIC = "not authentic"
_SHORTEST_KEY, _CODE_BYTES = 16, 16
Rows = NDArray[np.void]


class TeamKey:
    """A secret that the robots of a team share.

    Args:
        secret: at least 16 bytes.

    Raises:
        InvalidInputError: it is shorter.
    """

    def __init__(self, secret: bytes) -> None:
        if len(secret) < _SHORTEST_KEY:
            raise InvalidInputError("team key", f"has {len(secret)} bytes, expected at least 16")
        self._start = hmac.new(secret, digestmod="sha256")

    @classmethod
    def read(cls, path: str | Path) -> TeamKey:
        """The key in a file; white space at its ends does not count.

        Raises:
            InvalidInputError: the file cannot be read, or holds too short a key.
        """
        try:
            return cls(Path(path).read_bytes().strip())
        except OSError as error:
            raise InvalidInputError("team key", f"cannot read {path}: {error.strerror}") from error

    @classmethod
    def of_team(cls, path: str) -> TeamKey | None:
        """The key in a file; None, for a team without one, where no file is named.

        Raises:
            InvalidInputError: the file cannot be read, or holds too short a key.
        """
        return cls.read(path) if path else None

    def sign(self, rows: Rows) -> Rows:
        """The message with its code."""
        return with_header_values(rows, {"code": self._code(rows)})

    def verify(self, rows: Rows) -> Rows:
        """The message without its code.

        Raises:
            UpdateRefusedError: it has none, or not the right one.
        """
        plain, code = without_last_entry(rows, "code")
        if plain is None or not _is_same(self._code(plain), code):
            raise UpdateRefusedError("the message is not of this team", NOT_AUTHENTIC)
        return plain

    def code_of_text(self, text: str) -> str:
        """The code of a message that is a text, as hexadecimal digits."""
        return self._code_of(b"text\n", text.encode("utf-8", "surrogatepass"))

    def is_code_of_text(self, text: str, code: str) -> bool:
        """Whether a code is that of a text; takes as long for a wrong one as for the right one."""
        return _is_same(self.code_of_text(text), code)

    def _code(self, rows: Rows) -> str:
        fields = [(name, kind.base.str, kind.shape, at) for name, kind, at in layout_of(rows)]
        layout = json.dumps([fields, rows.dtype.itemsize], separators=(",", ":"))
        return self._code_of(layout.encode("ascii"), np.ascontiguousarray(rows).tobytes())

    def _code_of(self, *parts: bytes) -> str:
        summed = self._start.copy()
        for part in parts:
            summed.update(part)
        return summed.digest()[:_CODE_BYTES].hex()


def _is_same(code: str, other: str) -> bool:
    """Whether two codes are the same, in a time that does not depend on where they differ."""
    return hmac.compare_digest(code.encode(), other.encode("utf-8", "surrogatepass"))
