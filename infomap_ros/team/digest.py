"""Digests of contributions, and requests for what is missing: the wire format.

As map updates, they are rows of named fields with the header in the name of one more field.

- A summary has a row for each contribution that its sender holds: whose, the newest version, the
  number of blocks, and a hash of all states.
- Cells are hashes of parts of one contribution: cubes of 2^level blocks of 8^3 voxels.
- A request asks one robot for the cells or for the states of such cubes, without rows for all; or
  for map updates that it sent, by their serial numbers.

Each carries its sender's session and its number in it (`infomap_ros.team.digest`), and a request
the session of who is asked: a request to one that has ended is void.

Which digests and requests are received for the first time.

Each carries the session of its sender and a number that goes up by one with each of them; so what a
stranger has recorded and repeats is refused, also where it is signed.

Blocks of others' contributions that another robot holds otherwise, until they are mended.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError, UpdateRefusedError
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, COORDINATE_LIMIT
from infomap_ros.team.config import MISSED_FOR, MOST_MISSED, MOST_TRIES
from infomap_ros.team.contribution import Contribution, Corners
from infomap_ros.team.message_header import (
    dtype_with_header,
    header_of,
    whole_number,
    without_header,
)
from infomap_ros.team.update import MAX_ROBOT, MAX_SERIAL, MAX_SESSION, MAX_VERSION, is_newer

REPEATED = "repeated message"
MAX_NUMBER = 2**62
_WINDOW = 256  # messages; what is late by more is asked for or sent again anyway
_KEPT_SESSIONS = 16


class Freshness:
    """Remembers for each robot which numbers were received."""

    def __init__(self) -> None:
        self._received: dict[int, dict[int, tuple[int, int]]] = {}

    def check(self, sender: int, session: int, number: int) -> None:
        """Refuse what was received before, or is late by more than the window.

        Args:
            sender: id of the robot; whoever calls limits how many there are.
            session: number that it drew when it started.
            number: of the message.

        Raises:
            UpdateRefusedError: it is refused.
        """
        sessions = self._received.setdefault(sender, {})
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


SUMMARY_ROW = np.dtype(
    [("robot", "<u2"), ("newest", "<u4"), ("blocks", "<u4"), ("hash", "<u4", (2,))]
)
CELL_ROW = np.dtype([("corner", "<i4", (3,)), ("hash", "<u4")])
REQUEST_ROW = np.dtype([("corner", "<i4", (3,))])
MAX_LEVEL = 8
_CORNER_LIMIT = COORDINATE_LIMIT >> BLOCK_BITS
MAX_SUMMARY = 1024
"""Contributions that a summary has, at the most."""
_OVERHEAD = 500  # [bytes]


@dataclass(frozen=True, eq=False)
class Summary:
    """What a robot holds.

    Attributes:
        sender: id of the robot.
        session: number that it drew when it started.
        rows: of dtype `SUMMARY_ROW`; `hash` is its lower and its upper half.
        number: of the message in this session.
    """

    sender: int
    session: int
    rows: NDArray[np.void]
    number: int = 0

    def encode(self, number: int = 0) -> NDArray[np.void]:
        """The rows of a message with that number."""
        header = {"digest": "summary", "sender": self.sender, "session": self.session}
        return self.rows.view(dtype_with_header(SUMMARY_ROW, header | {"number": number}))

    def hashes(self) -> list[int]:
        """Hash of each contribution, 64 bits."""
        low, high = self.rows["hash"].astype(np.uint64).T
        return [int(value) for value in low | (high << np.uint64(32))]


@dataclass(frozen=True, eq=False)
class CellDigest:
    """Hashes of parts of a contribution.

    Attributes:
        sender: id of the robot that sends them.
        session: number that it drew when it started.
        robot: id of the robot whose contribution it is.
        version: newest version of the contribution when they were made.
        serial: of the last map update that the sender sent.
        level: see module.
        corners: of the cubes in units of their edge, shape (n, 3), int32.
        hashes: shape (n,), uint32; 0 where nothing is known.
        number: of the message in this session.
    """

    sender: int
    session: int
    robot: int
    version: int
    serial: int
    level: int
    corners: NDArray[np.int32]
    hashes: NDArray[np.uint32]
    number: int = 0

    def encode(self, max_bytes: int, number: int = 0) -> list[NDArray[np.void]]:
        """The rows of as many messages as it takes, with numbers from that one on."""
        header = {
            "digest": "cells",
            "sender": self.sender,
            "session": self.session,
            "robot": self.robot,
            "version": self.version,
            "serial": self.serial,
            "level": self.level,
        }
        rows = np.zeros(len(self.corners), CELL_ROW)
        rows["corner"], rows["hash"] = self.corners, self.hashes
        return _messages(rows, header, max_bytes, number)


@dataclass(frozen=True, eq=False)
class Request:
    """What a robot asks another for.

    Attributes:
        sender: id of the robot that asks.
        session: number that it drew when it started.
        to: id of the robot that is asked.
        to_session: session of that robot.
        robot: id of the robot whose contribution it is.
        wants: "cells", "states", or "messages", of which the numbers stand in `corners`.
        level: of the cells that are wanted; 0 for states.
        within: level of `corners`.
        corners: the cubes, in units of their edge, shape (n, 3), int32; none for all.
        number: of the message in the sender's session.
    """

    sender: int
    session: int
    to: int
    to_session: int
    robot: int
    wants: str
    level: int
    within: int
    corners: NDArray[np.int32]
    number: int = 0

    def parts(self, max_bytes: int) -> list[Request]:
        """The same in as many requests as it takes for each to fit one message."""
        length = _most_rows(REQUEST_ROW, max_bytes)
        starts = range(0, max(1, len(self.corners)), length)
        return [replace(self, corners=self.corners[start : start + length]) for start in starts]

    def encode(self, max_bytes: int, number: int = 0) -> list[NDArray[np.void]]:
        """The rows of as many messages as it takes, with numbers from that one on.

        Where all is wanted they have one row more.
        """
        everything = not len(self.corners)
        header = {
            "request": self.wants,
            "sender": self.sender,
            "session": self.session,
            "to": self.to,
            "to_session": self.to_session,
            "robot": self.robot,
            "level": self.level,
            "within": self.within,
            "all": int(everything),
        }
        rows = np.zeros(max(1, len(self.corners)), REQUEST_ROW)
        if not everything:
            rows["corner"] = self.corners
        return _messages(rows, header, max_bytes, number)


def _most_rows(row: np.dtype[np.void], max_bytes: int) -> int:
    return max(1, (max_bytes - _OVERHEAD) // row.itemsize)


def _messages(
    rows: NDArray[np.void], header: Mapping[str, object], max_bytes: int, number: int
) -> list[NDArray[np.void]]:
    """Rows in as many messages as it takes, numbered."""
    length = _most_rows(rows.dtype, max_bytes)
    parts = [rows[start : start + length] for start in range(0, len(rows), length)]
    return [
        part.view(dtype_with_header(rows.dtype, {**header, "number": number + count}))
        for count, part in enumerate(parts)
    ]


def decode_digest(rows: NDArray[np.void]) -> Summary | CellDigest:
    """Read a digest.

    Raises:
        InvalidInputError: it is not one, or holds impossible numbers.
    """
    header = header_of(rows, "digest")
    sender = whole_number(header, "sender", 0, MAX_ROBOT, "digest")
    session = whole_number(header, "session", 0, MAX_SESSION, "digest")
    number = whole_number(header, "number", 0, MAX_NUMBER, "digest")
    if header.get("digest") == "summary":
        table = without_header(rows, (SUMMARY_ROW,)).copy()
        if len(table) > MAX_SUMMARY or len(np.unique(table["robot"])) < len(table):
            raise InvalidInputError("digest", f"of {len(table)} contributions, or one is repeated")
        return Summary(sender, session, table, number)
    if header.get("digest") != "cells":
        raise InvalidInputError("digest", f"of kind '{header.get('digest', '')}'")
    table = without_header(rows, (CELL_ROW,))
    return CellDigest(
        sender,
        session,
        whole_number(header, "robot", 0, MAX_ROBOT, "digest"),
        whole_number(header, "version", 0, MAX_VERSION, "digest"),
        whole_number(header, "serial", 0, MAX_SERIAL, "digest"),
        whole_number(header, "level", 0, MAX_LEVEL, "digest"),
        _checked_corners(table, "digest"),
        table["hash"].copy(),
        number,
    )


def decode_request(rows: NDArray[np.void]) -> Request:
    """Read a request.

    Raises:
        InvalidInputError: it is not one, or holds impossible numbers.
    """
    header = header_of(rows, "request")
    wants = header.get("request", "")
    if wants not in ("cells", "states", "messages"):
        raise InvalidInputError("request", f"for '{wants}'")
    everything = whole_number(header, "all", 0, 1, "request")
    table = without_header(rows, (REQUEST_ROW,))
    is_place = wants != "messages"
    corners = _checked_corners(table, "request") if is_place else table["corner"].copy()
    return Request(
        whole_number(header, "sender", 0, MAX_ROBOT, "request"),
        whole_number(header, "session", 0, MAX_SESSION, "request"),
        whole_number(header, "to", 0, MAX_ROBOT, "request"),
        whole_number(header, "to_session", 0, MAX_SESSION, "request"),
        whole_number(header, "robot", 0, MAX_ROBOT, "request"),
        wants,
        whole_number(header, "level", 0, MAX_LEVEL, "request"),
        whole_number(header, "within", 0, MAX_LEVEL, "request"),
        corners[:0] if everything else corners,
        whole_number(header, "number", 0, MAX_NUMBER, "request"),
    )


def _checked_corners(table: NDArray[np.void], what: str) -> NDArray[np.int32]:
    corners = table["corner"].copy()
    if ((corners < -_CORNER_LIMIT) | (corners >= _CORNER_LIMIT)).any():
        raise InvalidInputError(what, "a cell lies outside the coordinate limits")
    x, y, z = corners.astype(np.int64).T + _CORNER_LIMIT
    if len(np.unique((x * 2 * _CORNER_LIMIT + y) * 2 * _CORNER_LIMIT + z)) < len(corners):
        raise InvalidInputError(what, "a cell is repeated")
    return np.asarray(corners, np.int32)


class _Block(NamedTuple):
    """How a block should be: hash and version; since when that is known; how often asked for."""

    hash: int
    version: int
    since: float
    tries: int


class Missed:
    """Missed blocks of all contributions. They are forgotten when they are mended, or too old.

    Args:
        late: time for which a block is missed before it is asked for [s].
        request_timeout: time until it is asked for again [s].
    """

    def __init__(self, late: float, request_timeout: float) -> None:
        self._late, self._request_timeout = late, request_timeout
        self._blocks: dict[int, dict[tuple[int, ...], _Block]] = {}
        self._sender: dict[int, int] = {}
        self._checked = -np.inf

    def __len__(self) -> int:
        return sum(map(len, self._blocks.values()))

    @property
    def robots(self) -> tuple[int, ...]:
        """Ids of the robots whose contributions lack something."""
        return tuple(self._blocks)

    def receive(self, digest: CellDigest, now: float) -> None:
        """Remember what a digest says; where there are too many, the oldest of the most go."""
        self._sender[digest.robot] = digest.sender
        blocks = self._blocks.setdefault(digest.robot, {})
        for place, value in zip(digest.corners.tolist(), digest.hashes.tolist(), strict=True):
            known = blocks.pop(corner := tuple(place), None)
            if known is None or known.hash != value:
                known = _Block(value, digest.version, now, 0)
            blocks[corner] = known._replace(version=digest.version)
        while (excess := len(self) - MOST_MISSED) > 0:
            most = max(self._blocks.values(), key=len)
            for corner in list(most)[:excess]:
                del most[corner]

    def is_due(self, now: float) -> bool:
        """Whether it is time to look what is still missed; then it counts as looked at."""
        if now - self._checked < 0.5 * self._request_timeout:
            return False
        self._checked = now
        return True

    def to_ask(self, robot: int, part: Contribution | None, now: float) -> tuple[int, Corners]:
        """Whom to ask for which blocks of a contribution now; they count as asked for.

        Args:
            robot: whose contribution it is.
            part: what is held of it, None where nothing is.
            now: time of any steady clock [s].
        """
        blocks = self._blocks[robot]
        self._drop_mended(blocks, part)
        due = []
        for corner, block in list(blocks.items()):
            if block.tries >= MOST_TRIES or now - block.since > MISSED_FOR:
                del blocks[corner]
            elif now - block.since >= self._late + block.tries * self._request_timeout:
                blocks[corner] = block._replace(tries=block.tries + 1)
                due.append(corner)
        if not blocks:
            del self._blocks[robot]
        return self._sender[robot], np.array(due, np.int32).reshape(-1, 3)

    @staticmethod
    def _drop_mended(blocks: dict[tuple[int, ...], _Block], part: Contribution | None) -> None:
        if part is None or not blocks:
            return
        hashes, newest = part.blocks_at(np.array(list(blocks), np.int32))
        states = zip(list(blocks.items()), hashes.tolist(), newest, strict=True)
        for (corner, block), value, own in states:
            if value == block.hash or (own and is_newer(own, np.uint32(block.version))):
                del blocks[corner]
