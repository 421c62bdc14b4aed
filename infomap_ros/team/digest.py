"""Digests of contributions, and requests for what is missing: the wire format.

As map updates, they are rows of named fields with the header in the name of one more field.

- A summary has a row for each contribution that its sender holds: whose, the newest version, the
  number of blocks, and a hash of all states.
- Cells are hashes of parts of one contribution: cubes of 2^level blocks of 8^3 voxels.
- A request asks one robot for the cells or for the states of such cubes, without rows for all; or
  for map updates that it told, by their serial numbers.

Each carries its sender's session and its number in it (`infomap_ros.team.freshness`), and a request
the session of who is asked: a request to one that has ended is void.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, COORDINATE_LIMIT
from infomap_ros.team.freshness import MAX_NUMBER
from infomap_ros.team.message_header import (
    dtype_with_header,
    header_of,
    whole_number,
    without_header,
)
from infomap_ros.team.update import MAX_ROBOT, MAX_SERIAL, MAX_SESSION, MAX_VERSION

SUMMARY_ROW = np.dtype(
    [("robot", "<u2"), ("newest", "<u4"), ("blocks", "<u4"), ("hash", "<u4", (2,))]
)
CELL_ROW = np.dtype([("corner", "<i4", (3,)), ("hash", "<u4")])
REQUEST_ROW = np.dtype([("corner", "<i4", (3,))])
MAX_LEVEL = 8
_CORNER_LIMIT = COORDINATE_LIMIT >> BLOCK_BITS
MAX_SUMMARY = 1024
"""Contributions that a summary tells of, at the most."""
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
        sender: id of the robot that tells them.
        session: number that it drew when it started.
        robot: id of the robot whose contribution it is.
        version: newest version of the contribution when they were made.
        serial: of the last map update that the sender told.
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
