"""Finds what was missed: compares digests and asks for what differs.

Robots tell from time to time what they hold, as hashes. Who holds something else asks for finer
hashes of what differs, and at last for the states themselves. The owner of a contribution is
asked; when it has not been heard for some time, whoever holds something else. All answers go to
all, so that one answer serves everybody who has missed the same.
"""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.team.config import TeamConfig
from infomap_ros.team.contribution import Cells, Contribution, Corners
from infomap_ros.team.digest import SUMMARY_ROW, CellDigest, Request, Summary
from infomap_ros.team.losses import Losses
from infomap_ros.team.outbox import Outbox
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.versions import is_newer

_COARSE = 3  # level of the first cells that are compared
_MANY_BLOCKS = 4000  # with fewer, blocks are compared at once
_DEEP_PERIOD = 1.0  # [s] between two comparisons of a whole contribution
_OWN_PERIOD = 5.0  # [s] of the own contribution, which others may hold from an earlier start
_LATE, _GIVEN_UP = 6.0, 8.0  # patiences from which blocks are asked for, and messages are not
_REPEATS = 3  # digests that tell of a block that was told
_MOST_HELD = 1 << 16  # blocks held otherwise that are kept, as in a message of 1 MB; the oldest go
_EVERYTHING: Corners = np.empty((0, 3), np.int32)


class _Block(NamedTuple):
    """How a block should be: its hash, at which version, and since when that is heard."""

    hash: int
    version: int
    heard: float


class _Missed:
    """Blocks of a contribution that another robot holds otherwise.

    Attributes:
        sender: the robot that was heard last.
        blocks: how they should be.
    """

    def __init__(self) -> None:
        self.sender = 0
        self.blocks: dict[tuple[int, ...], _Block] = {}

    def hear(self, digest: CellDigest, now: float) -> None:
        """Remember what a digest says."""
        self.sender = digest.sender
        for place, value in zip(digest.corners.tolist(), digest.hashes.tolist(), strict=True):
            corner = tuple(place)
            known = self.blocks.get(corner)
            since = now if known is None or known.hash != value else known.heard
            self.blocks[corner] = _Block(value, digest.version, since)

    def left(self, part: Contribution | None, before: float) -> Corners:
        """The blocks that are missed since before a time; those not missed are forgotten."""
        if part is not None and self.blocks:
            hashes, newest = part.blocks_at(np.array(list(self.blocks), np.int32))
            states = zip(list(self.blocks.items()), hashes.tolist(), newest, strict=True)
            for (corner, block), value, own in states:
                if value == block.hash or (own and is_newer(own, np.uint32(block.version))):
                    del self.blocks[corner]
        due = [corner for corner, block in self.blocks.items() if block.heard <= before]
        return np.array(due, np.int32).reshape(-1, 3)


class Reconciler:
    """Makes digests and requests, and answers them.

    Args:
        replica: what was told and heard.
        outbox: sends the answers, and knows this robot.
        config: of the team.
        holds_own: whether this is where the robot's own contribution is made; a replica that
            only listens tells no digests.
    """

    def __init__(
        self, replica: MapReplica, outbox: Outbox, config: TeamConfig, holds_own: bool
    ) -> None:
        self._replica, self._outbox, self._config = replica, outbox, config
        self._own, self._holds_own = outbox.robot, holds_own
        self.recovering_until = np.inf
        self._heard: dict[int, float] = {}
        self._behind: dict[tuple[int, int], float] = {}
        self._held: dict[tuple[int, ...], int] = {}
        self._compared: dict[tuple[int, int], float] = {}
        self._asked: dict[tuple[int, tuple[int, ...]], float] = {}
        self._missed: dict[int, _Missed] = {}
        self.losses = Losses(config.patience, _GIVEN_UP * config.patience)
        self._requests: list[Request] = []
        self._wanted: list[CellDigest] = []
        self._recent: list[Corners] = []
        self._summarised = -np.inf

    def digests(self, now: float) -> list[NDArray[np.void]]:
        """Messages that tell what this robot holds: what was touched, asked for, and a summary."""
        wanted, self._wanted = self._wanted, []
        if not self._holds_own:
            return []
        self._recent = [*self._recent[1 - _REPEATS :], self._outbox.take_touched()]
        corners = np.unique(np.concatenate(self._recent), axis=0)
        if len(corners):
            wanted.append(self._cells(self._own, 0, 0, corners))
        messages = [rows for d in wanted for rows in d.encode(self._config.message_size)]
        if now - self._summarised >= self._config.summary_period:
            self._summarised = now
            messages.append(self._summary().encode())
        return messages

    def requests(self, now: float) -> list[NDArray[np.void]]:
        """Messages that ask others for what is missing, again where no answer has come."""
        for robot, serials in self.losses.to_ask(now).items():
            numbers = np.stack([serials, 0 * serials, 0 * serials], axis=-1)
            for _ in range(2):  # a request is small, and lost as easily as what it asks for
                self._ask(robot, robot, "messages", 0, 0, numbers)
        for robot, missed in list(self._missed.items()):
            before = now - _LATE * self._config.patience
            left = missed.left(self._replica.contribution(robot), before)
            corners = self._not_yet_asked(robot, left, 0, now)
            if len(corners):
                self._ask(missed.sender, robot, "states", 0, 0, corners)
            if not missed.blocks:
                del self._missed[robot]
        requests, self._requests = self._requests, []
        return [rows for r in requests for rows in r.encode(self._config.message_size)]

    def hear_summary(self, summary: Summary, now: float) -> None:
        """Compare what another robot holds with what is held here."""
        sender = summary.sender
        self._heard[sender] = now
        for row, value in zip(summary.rows, summary.hashes(), strict=True):
            robot, newest = int(row["robot"]), int(row["newest"])
            if self._is_own(robot):
                self._outbox.catch_up(newest)
            elif sender != robot and self._is_present(robot, now):
                continue
            self._compare_whole(sender, robot, value, now)

    def hear_cells(self, digest: CellDigest, now: float) -> None:
        """Ask for what differs in some parts of a contribution."""
        if digest.sender != self._own or not self._holds_own:
            self.losses.expect(digest.sender, digest.serial, now)
        if digest.level == 0 and not self._is_own(digest.robot):
            self._missed.setdefault(digest.robot, _Missed()).hear(digest, now)
            return
        part = self._replica.contribution(digest.robot)
        cells = Cells(digest.level, digest.corners, digest.hashes)
        other = cells.hashes != 0 if part is None else part.compare(cells)
        if digest.level == 0:
            still = self._is_held_still(digest, other)
            other &= still | self._is_new_here(part, digest, now)
        corners = self._not_yet_asked(digest.robot, cells.corners[other], digest.level, now)
        if len(corners):
            wants = "cells" if digest.level else "states"
            self._ask(digest.sender, digest.robot, wants, 0, digest.level, corners)

    def _is_held_still(self, digest: CellDigest, other: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which blocks of the own contribution another robot held like that before, too, (n,).

        Others lag behind; what they go on holding may be from before this robot started.

        Args:
            digest: what is held.
            other: where that differs from what is held here, shape (n,); only this is kept.
        """
        held, still = self._held, np.zeros(len(other), np.bool_)
        blocks = zip(digest.corners.tolist(), digest.hashes.tolist(), other.tolist(), strict=True)
        for row, (corner, value, differs) in enumerate(blocks):
            block = digest.sender, *corner
            still[row] = held.pop(block, None) == value
            if differs:
                held[block] = value
        for block in list(islice(held, max(0, len(held) - _MOST_HELD))):
            del held[block]
        return still

    def _is_new_here(
        self, part: Contribution | None, digest: CellDigest, now: float
    ) -> NDArray[np.bool_]:
        """Which blocks this robot has told nothing of since it started, while it recovers."""
        if part is None:
            return np.full(len(digest.corners), now < self.recovering_until)
        return (part.blocks_at(digest.corners)[0] == 0) & (now < self.recovering_until)

    def hear_request(self, request: Request, now: float) -> None:
        """Answer what this robot is asked; what others ask for need not be asked for again."""
        if request.wants == "messages":
            if request.to == self._own and self._holds_own:
                self._outbox.resend(request.corners[:, 0].tolist(), now)
            self.losses.asked(request.to, request.corners[:, 0], now)
            return
        if request.to != self._own or not self._holds_own:
            self._not_yet_asked(request.robot, request.corners, request.within, now)
            return
        part = self._replica.contribution(request.robot)
        if part is None:
            return
        corners = request.corners if len(request.corners) else None
        if request.wants == "cells":
            within = request.within
            self._wanted.append(self._cells(request.robot, request.level, within, corners))
        elif corners is None:
            self._outbox.answer(request.robot, np.arange(part.blocks))
        else:
            self._outbox.answer(request.robot, part.slots_in(request.within, corners))

    def _is_own(self, robot: int) -> bool:
        return robot == self._own and self._holds_own

    def _is_present(self, robot: int, now: float) -> bool:
        return now - self._heard.get(robot, -np.inf) < self._config.silence

    def _compare_whole(self, sender: int, robot: int, value: int, now: float) -> None:
        part = self._replica.contribution(robot)
        if value == (0 if part is None else part.hash()):
            self._behind.pop((sender, robot), None)
            return
        first = self._behind.setdefault((sender, robot), now)
        last = self._compared.get((sender, robot), -np.inf)
        period, wait = _DEEP_PERIOD, 3.0 * self._config.patience
        if self._is_own(robot):
            recovers = now < self.recovering_until
            period, wait = (_DEEP_PERIOD, 0.0) if recovers else (_OWN_PERIOD, wait)
        if part is None and now - last >= period:
            self._compared[sender, robot] = now
            self._ask(sender, robot, "states", 0, 0, _EVERYTHING)
        elif now - first >= wait and now - last >= period:
            self._compared[sender, robot] = now
            level = _COARSE if part is not None and part.blocks > _MANY_BLOCKS else 0
            self._ask(sender, robot, "cells", level, 0, _EVERYTHING)

    def _ask(
        self, to: int, robot: int, wants: str, level: int, within: int, corners: Corners
    ) -> None:
        self._requests.append(Request(self._own, to, robot, wants, level, within, corners))

    def _not_yet_asked(self, robot: int, corners: Corners, level: int, now: float) -> Corners:
        """Those cells for which nobody has asked lately; they count as asked for now."""
        patience = self._config.patience
        if len(self._asked) > 100_000:
            self._asked = {k: t for k, t in self._asked.items() if now - t < patience}
        fresh = []
        for row, corner in enumerate(corners.tolist()):
            key = robot, (level, *corner)
            if now - self._asked.get(key, -np.inf) >= patience:
                self._asked[key] = now
                fresh.append(row)
        return corners[fresh]

    def _cells(self, robot: int, level: int, within: int, corners: Corners | None) -> CellDigest:
        part = self._replica.contribution(robot)
        cells = Cells(level, _EVERYTHING, np.empty(0, np.uint32))
        if part is not None:
            cells = part.cells(level, within, corners)
        newest = 0 if part is None else part.newest
        parts = level, cells.corners, cells.hashes
        serial = self._outbox.serial
        return CellDigest(self._own, self._outbox.session, robot, newest, serial, *parts)

    def _summary(self) -> Summary:
        robots = self._replica.robots
        rows = np.zeros(len(robots), SUMMARY_ROW)
        for row, robot in enumerate(robots):
            part = self._replica.contribution(robot)
            if part is not None:
                value = part.hash()
                rows[row] = robot, part.newest, part.blocks, (value & 0xFFFFFFFF, value >> 32)
        return Summary(self._own, self._outbox.session, rows)
