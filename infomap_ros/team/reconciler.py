"""Finds what was missed: compares digests and asks for what differs.

Robots send from time to time what they hold, as hashes. Who holds something else asks for finer
hashes of what differs, and at last for the states themselves. The owner of a contribution is
asked; when it has been silent for some time, whoever holds something else. All answers go to
all, so that one answer serves everybody who has missed the same.

Digests and requests take a part of the bandwidth (`limits.TALK_SHARE`), each robot's questions an
equal part of that. So nobody can keep this robot from telling its map by asking.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, islice, zip_longest

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import UpdateRefusedError
from infomap_ros.team.config import (
    MOST_ROBOTS,
    MOST_WANTED,
    REQUEST_TIMEOUT,
    TALK_SHARE,
    Budget,
    TeamConfig,
)
from infomap_ros.team.contribution import Cells, Contribution, Corners
from infomap_ros.team.digest import (
    CELL_ROW,
    REPEATED,
    SUMMARY_ROW,
    CellDigest,
    Missed,
    Request,
    Summary,
)
from infomap_ros.team.outbox import Outbox
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import message_bytes

_WINDOW = 2000  # messages; a larger gap is a robot that has started again, or a long silence


@dataclass
class _Loss:
    """When a loss was noticed, and when the message was asked for."""

    noticed: float
    asked: float = -np.inf


class Losses:
    """Keeps account of the messages of each robot.

    Args:
        request_timeout: time until a message is asked for again [s].
        give_up: time until it is not asked for any more [s].
    """

    def __init__(self, request_timeout: float, give_up: float) -> None:
        self._request_timeout, self._give_up = request_timeout, give_up
        self._newest: dict[int, int] = {}
        self._lost: dict[int, dict[int, _Loss]] = {}

    def receive(self, robot: int, serial: int, now: float) -> None:
        """A message with this number has come."""
        self.expect(robot, serial, now)
        self._lost.get(robot, {}).pop(serial, None)

    def expect(self, robot: int, serial: int, now: float) -> None:
        """A robot says that this is the number of its last message."""
        newest = self._newest.get(robot)
        if newest is None or abs(serial - newest) > _WINDOW:
            self._newest[robot] = serial
            self._lost[robot] = {}
            return
        lost = self._lost[robot]
        for number in range(newest + 1, serial + 1):
            lost[number] = _Loss(now)
        for number in list(islice(lost, max(0, len(lost) - _WINDOW))):
            del lost[number]
        self._newest[robot] = max(newest, serial)

    def asked(self, robot: int, serials: NDArray[np.int32], now: float) -> None:
        """Another robot has asked for messages of a robot: the answer goes to all.

        That counts once for each message, so that who always asks keeps nobody else from it.
        """
        lost = self._lost.get(robot, {})
        for serial in serials.tolist():
            if serial in lost and lost[serial].asked == -np.inf:
                lost[serial].asked = now

    def to_ask(self, now: float) -> dict[int, NDArray[np.int32]]:
        """Numbers of the messages to be asked for now, for each robot; they count as asked for."""
        wanted = {}
        for robot, lost in self._lost.items():
            for serial in [n for n, loss in lost.items() if now - loss.noticed > self._give_up]:
                del lost[serial]
            due = [n for n, loss in lost.items() if now - loss.asked >= self._request_timeout]
            if due:
                wanted[robot] = np.array(due, np.int32)
                for number in due:
                    lost[number].asked = now
        return wanted


_COARSE = 3  # level of the first cells that are compared
_MANY_BLOCKS = 4000  # with fewer, blocks are compared at once
_DEEP_PERIOD = 1.0  # [s] between two comparisons of a whole contribution
_OWN_PERIOD = 5.0  # [s] of the own contribution, which others may hold from an earlier start
_LATE, _GIVEN_UP = (
    6.0,
    8.0,
)  # timeouts after which blocks are asked for, messages not
_SUMMARY_PERIOD = 1.0  # between two summaries of all that this robot holds [s]
_REPEATS = 3  # digests with a block that was sent
_MOST_HELD = 1 << 16  # blocks held otherwise that are kept, as in a message of 1 MB; the oldest go
_ANSWERS = 16  # to questions in one round; each may take 10 ms for a map of 10^5 blocks
_MOST_ASKED = 100_000  # cells of which it is known when they were asked for
_MOST_COMPARED = 2 * MOST_ROBOTS**2  # what each of a full team holds of each, twice
Rows = NDArray[np.void]
_EVERYTHING: Corners = np.empty((0, 3), np.int32)


class Reconciler:
    """Makes digests and requests, and answers them.

    Args:
        replica: what was sent and received.
        outbox: sends the answers, and knows this robot.
        config: of the team.
        holds_own: whether this is where the robot's own contribution is made; a replica that
            only listens sends no digests.
        may_be_kept: says of a robot's id whether anything may be kept of it.
    """

    def __init__(
        self,
        replica: MapReplica,
        outbox: Outbox,
        config: TeamConfig,
        holds_own: bool,
        may_be_kept: Callable[[int], bool],
    ) -> None:
        self._replica, self._outbox, self._config = replica, outbox, config
        self._own, self._holds_own = outbox.robot, holds_own
        self._may_be_kept = may_be_kept
        self.recovering_until = np.inf
        self._received: dict[int, float] = {}
        self._sessions: dict[int, int] = {}
        self._behind: dict[tuple[int, int], float] = {}
        self._held: dict[tuple[int, ...], int] = {}
        self._compared: dict[tuple[int, int], float] = {}
        self._asked: dict[tuple[int, tuple[int, ...]], float] = {}
        self._missed = Missed(_LATE * REQUEST_TIMEOUT, REQUEST_TIMEOUT)
        self.losses = Losses(REQUEST_TIMEOUT, _GIVEN_UP * REQUEST_TIMEOUT)
        self._requests: list[Request] = []
        self._wanted: dict[int, dict[tuple[object, ...], Request]] = {}
        self._answered: dict[tuple[int, int], float] = {}
        self._recent: list[Corners] = []
        self._untold: list[tuple[int, ...]] = []
        self._summarized = -np.inf
        self._number = 0
        rate = TALK_SHARE * config.bandwidth * 1e6
        self._for_digests, self._for_answers, self._for_requests = (Budget(rate) for _ in range(3))

    def meet(self, robot: int, session: int, *, is_sure: bool = True) -> None:
        """A robot sends in a session; if that is not sure, it counts where none is known."""
        if is_sure:
            self._sessions[robot] = session
        else:
            self._sessions.setdefault(robot, session)

    def digests(self, now: float) -> list[Rows]:
        """Messages with what this robot holds: what was touched, asked for, and a summary."""
        if not self._holds_own:
            return []
        messages: list[Rows] = []
        if now - self._summarized >= _SUMMARY_PERIOD:
            self._summarized = now
            messages.append(self._summary().encode(self._number))
        room = max(0.0, self._for_digests.available(now))
        touched = self._touched(int(room) // CELL_ROW.itemsize)
        if len(touched):
            messages += self._encoded(self._cells(self._own, 0, 0, touched), len(messages))
        self._count(messages, self._for_digests)
        for _ in range(_ANSWERS):
            if not self._wanted or self._for_answers.available(now) <= 0.0:
                break
            answer = self._answer(self._next_wanted(), now)
            self._count(answer, self._for_answers)
            messages += answer
        return messages

    def _touched(self, most: int) -> Corners:
        """Blocks that were sent lately, those first for which there was no room before."""
        self._recent = [*self._recent[1 - _REPEATS :], self._outbox.take_touched()]
        recent = np.unique(np.concatenate(self._recent), axis=0).tolist()
        corners = list(dict.fromkeys(map(tuple, chain(self._untold, recent))))
        self._untold = corners[most:]
        return np.array(corners[:most], np.int32).reshape(-1, 3)

    def requests(self, now: float) -> list[Rows]:
        """Messages that ask others for what is missing, again where no answer has come.

        What the bandwidth has no room for is not asked now; it is missed, and comes again.
        """
        for robot, serials in self.losses.to_ask(now).items():
            numbers = np.stack([serials, 0 * serials, 0 * serials], axis=-1)
            for _ in range(2):  # a request is small, and lost as easily as what it asks for
                self._ask(robot, robot, "messages", 0, 0, numbers)
        for robot in self._missed.robots if self._missed.is_due(now) else ():
            sender, due = self._missed.to_ask(robot, self._replica.contribution(robot), now)
            corners = self._not_yet_asked(robot, due, 0, now)
            if len(corners):
                self._ask(sender, robot, "states", 0, 0, corners)
        size, asked = self._config.message_size, dict[int, list[Request]]()
        for request in self._requests:
            asked.setdefault(request.to, []).extend(request.parts(size))
        self._requests = []
        messages: list[Rows] = []
        for part in chain.from_iterable(zip_longest(*asked.values())):  # each robot in turn
            if part is not None and self._for_requests.available(now) > 0.0:
                encoded = part.encode(size, self._number)
                self._count(encoded, self._for_requests)
                messages += encoded
        return messages

    def receive_summary(self, summary: Summary, now: float) -> None:
        """Compare what another robot holds with what is held here."""
        sender, strangers = summary.sender, 0
        self._received[sender] = now
        for row, value in zip(summary.rows, summary.hashes(), strict=True):
            robot, newest = int(row["robot"]), int(row["newest"])
            part = self._replica.contribution(robot)
            strangers += part is None
            if strangers > MOST_ROBOTS or not self._may_be_kept(robot):
                continue
            if self._is_own(robot):
                self._outbox.own_version.follow(newest, sender, now)
            elif sender != robot and self._is_present(robot, now):
                continue
            if part is None or not part.is_cut:
                self._compare_whole(sender, robot, value, now)

    def receive_cells(self, digest: CellDigest, now: float) -> None:
        """Ask for what differs in some parts of a contribution."""
        if digest.sender != self._own or not self._holds_own:
            self.losses.expect(digest.sender, digest.serial, now)
        part = self._replica.contribution(digest.robot)
        if (part is not None and part.is_cut) or not self._may_be_kept(digest.robot):
            return
        if digest.sender != digest.robot and self._is_present(digest.robot, now):
            return  # it says itself what it holds
        if digest.level == 0 and not self._is_own(digest.robot):
            self._missed.receive(digest, now)
            return
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
        """Which blocks this robot has sent nothing of since it started, while it recovers."""
        if part is None:
            return np.full(len(digest.corners), now < self.recovering_until)
        return (part.blocks_at(digest.corners)[0] == 0) & (now < self.recovering_until)

    def receive_request(self, request: Request, now: float) -> None:
        """Answer what this robot is asked; what others ask for need not be asked for again."""
        if request.to != self._own or not self._holds_own:
            if request.wants == "messages":
                self.losses.asked(request.to, request.corners[:, 0], now)
            else:
                self._note_asked(request, now)
        elif request.to_session != self._outbox.session:
            text = f"robot {request.sender} asks session {request.to_session} of this robot"
            raise UpdateRefusedError(text, REPEATED)
        elif request.wants == "messages":
            self._outbox.resend(request.corners[:, 0].tolist(), now)
        elif request.wants == "states" and not request.within and len(request.corners):
            self._answer(request, now)
        else:
            questions = self._wanted.setdefault(request.sender, {})
            if len(questions) < MOST_WANTED:
                kind = request.wants, request.robot, request.level, request.within
                questions[*kind, request.corners.tobytes()] = request

    def _next_wanted(self) -> Request:
        """The oldest question of the robot whose turn it is."""
        sender = next(iter(self._wanted))
        questions = self._wanted.pop(sender)
        request = questions.pop(next(iter(questions)))
        if questions:
            self._wanted[sender] = questions
        return request

    def _answer(self, request: Request, now: float) -> list[Rows]:
        """The messages that answer a question; states are sent as map updates, by and by."""
        robot, within = request.robot, request.within
        part = self._replica.contribution(robot)
        if part is None:
            return []
        everything = not len(request.corners)
        corners, level = None if everything else request.corners, request.level
        if everything and part.blocks > _MANY_BLOCKS:
            level = max(level, _COARSE)
        if everything:
            key = robot, level if request.wants == "cells" else -1
            if now - self._answered.get(key, -np.inf) < 0.5 * _DEEP_PERIOD:
                return []  # the answer goes to all
            self._answered[key] = now
        if request.wants == "cells":
            return self._encoded(self._cells(robot, level, within, corners))
        slots = np.arange(part.blocks) if corners is None else part.slots_in(within, corners)
        self._outbox.answer(robot, slots)
        return []

    def _is_own(self, robot: int) -> bool:
        return robot == self._own and self._holds_own

    def _is_present(self, robot: int, now: float) -> bool:
        return now - self._received.get(robot, -np.inf) < self._config.silence

    def _compare_whole(self, sender: int, robot: int, value: int, now: float) -> None:
        part = self._replica.contribution(robot)
        if value == (0 if part is None else part.hash()):
            self._behind.pop((sender, robot), None)
            return
        for known in (self._behind, self._compared):
            for old in list(islice(known, max(0, len(known) - _MOST_COMPARED))):
                del known[old]
        first = self._behind.setdefault((sender, robot), now)
        last = self._compared.get((sender, robot), -np.inf)
        period, wait = _DEEP_PERIOD, 3.0 * REQUEST_TIMEOUT
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
        """Ask a robot whose session is known."""
        if to in self._sessions:
            who = self._own, self._outbox.session, to, self._sessions[to]
            self._requests.append(Request(*who, robot, wants, level, within, corners))

    def _not_yet_asked(self, robot: int, corners: Corners, level: int, now: float) -> Corners:
        """Those cells for which nobody has asked lately; they count as asked for now."""
        fresh = []
        for row, corner in enumerate(corners.tolist()):
            key = robot, (level, *corner)
            if now - self._asked.get(key, -np.inf) >= REQUEST_TIMEOUT:
                self._asked[key] = now
                fresh.append(row)
        self._forget_asked(now)
        return corners[fresh]

    def _note_asked(self, request: Request, now: float) -> None:
        """Leave to others what they ask for, once: who always asks must not silence this robot."""
        for corner in request.corners.tolist():
            self._asked.setdefault((request.robot, (request.within, *corner)), now)
        self._forget_asked(now)

    def _forget_asked(self, now: float) -> None:
        if len(self._asked) > _MOST_ASKED:
            self._asked = {k: t for k, t in self._asked.items() if now - t < REQUEST_TIMEOUT}
            if len(self._asked) > _MOST_ASKED // 2:
                self._asked.clear()

    def _encoded(self, digest: CellDigest, before: int = 0) -> list[Rows]:
        return digest.encode(self._config.message_size, self._number + before)

    def _count(self, messages: list[Rows], budget: Budget) -> None:
        """Count messages as sent."""
        self._number += len(messages)
        budget.spend(sum(map(message_bytes, messages)))

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
        kept = [(robot, self._replica.contribution(robot)) for robot in self._replica.robots]
        robots = [robot for robot, part in kept if part is not None and not part.is_cut]
        rows = np.zeros(len(robots), SUMMARY_ROW)
        for row, robot in enumerate(robots):
            part = self._replica.contribution(robot)
            if part is not None:
                value = part.hash()
                rows[row] = robot, part.newest, part.blocks, (value & 0xFFFFFFFF, value >> 32)
        return Summary(self._own, self._outbox.session, rows)
