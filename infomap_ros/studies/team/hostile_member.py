"""A team of which one member lies: the others' maps, beside what they are without it.

The liar has the key and is on the list, as far as the team has them. It sees nothing; in turn it

- fills the memory with voxels that it has not seen;
- sends digests of blocks that do not exist, and summaries of robots that do not exist, in which
  the others have sent versions far ahead;
- hands on states of the others, and back to them, that they have not sent;
- asks for everything, and repeats what the others have said and asked.

It begins when the others have recovered from their start: until then a robot believes what others
know of its past.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InfomapError, UpdateRefusedError
from infomap_ros.mapping import SHARED_LOG_ODDS_LIMIT
from infomap_ros.mapping.voxels.changes import changed_blocks
from infomap_ros.studies.team.team_network import Channel, Radio, Rows, TeamNetwork
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.digest import SUMMARY_ROW, CellDigest, Request, Summary
from infomap_ros.team.update import MapUpdate, message_bytes
from infomap_ros.team.wire import encode_update

LIAR = 3
"""Id of the liar; robots 0, 1 and 2 are honest."""

_RECOVERY = 1.0  # [s]
_MESSAGE = 20_000  # bytes
_SESSION, _FIRST_VERSION = 666, 1000  # of the liar; all begin with the same version
_ROWS = 1000  # of a lie
_AHEAD = (0, 5000, 2**24, 2**30, 2**31 - 2000)  # versions, by which others are said to have gone on
_REPEATED = 50  # messages of others that it remembers
_LONGEST_END = 60.0  # [s] after the last view, until the honest robots should have all
Messages = list[tuple[str, Rows]]


class Liar:
    """Makes the messages of a hostile member.

    Args:
        sessions: of the others, which it has received.
        voxel_size: [m].
        bandwidth: bytes that it sends on average [bytes/s].
        seed: of what it makes up.

    Attributes:
        counts: messages by kind of lie.
    """

    def __init__(self, sessions: list[int], voxel_size: float, bandwidth: float, seed: int) -> None:
        self._sessions, self._size, self._bandwidth = sessions, voxel_size, bandwidth
        self._rng = np.random.default_rng(seed)
        self._number, self._version, self._turn, self._sent = 0, _FIRST_VERSION, 0, 0.0
        self._received: deque[tuple[str, Rows]] = deque(maxlen=_REPEATED)
        self.counts: Counter[str] = Counter()

    def receive(self, kind: str, rows: Rows) -> None:
        """Remember what another one has said, to repeat it."""
        self._received.append((kind, rows))

    def speak(self, now: float) -> Messages:
        """What it sends until a time [s]: one lie after another, as long as it may."""
        lies: tuple[Callable[[], Messages], ...] = (
            self._fill, self._digest, self._summary, self._hand_on, self._ask, self._repeat,
        )  # fmt: skip
        sent: Messages = []
        while self._sent < self._bandwidth * (now - _RECOVERY):
            lie = lies[self._turn % len(lies)]
            self._turn += 1
            made = lie()
            sent += made
            self._sent += max(1000, sum(message_bytes(rows) for _, rows in made))
            self.counts[lie.__name__.strip("_")] += len(made)
        return sent

    def _fill(self) -> Messages:
        """One voxel of each of many blocks far from where the others are."""
        low = np.array([4096, 0, 0]) + 256 * self._rng.integers(0, 100, 3)
        return self._update(LIAR, low + 8 * self._rng.integers(0, 32, (_ROWS, 3)), 0)

    def _digest(self) -> Messages:
        corners = np.unique(self._rng.integers(-1000, 1000, (_ROWS, 3)), axis=0).astype(np.int32)
        robot, serial = int(self._rng.integers(LIAR + 1)), int(self._rng.integers(2**31))
        about = LIAR, _SESSION, robot, self._version, serial, 0
        digest = CellDigest(*about, corners, np.ones(len(corners), np.uint32))
        return [("digest", rows) for rows in digest.encode(_MESSAGE, self._next())]

    def _summary(self) -> Messages:
        rows = np.zeros(_ROWS, SUMMARY_ROW)
        rows["robot"], rows["hash"] = np.arange(_ROWS), 3
        rows["newest"] = _FIRST_VERSION + self._rng.choice(_AHEAD, _ROWS)
        return [("digest", Summary(LIAR, _SESSION, rows).encode(self._next()))]

    def _hand_on(self) -> Messages:
        """States of another one, where it maps, that it has never sent."""
        box = self._rng.integers(-100, 100, (_ROWS, 3))
        return self._update(self._other(), box, int(self._rng.choice(_AHEAD)), LIAR)

    def _ask(self) -> Messages:
        other, wants = self._other(), ("cells", "states")[self._turn // 6 % 2]
        who = LIAR, _SESSION, other, self._sessions[other], self._other()
        request = Request(*who, wants, 0, 0, np.empty((0, 3), np.int32))
        return [("request", rows) for rows in request.encode(_MESSAGE, self._next())]

    def _repeat(self) -> Messages:
        return list(self._received)

    def _update(
        self, robot: int, indices: NDArray[np.int64], ahead: int, sender: int | None = None
    ) -> Messages:
        self._version += 1
        count = len(indices)
        update = MapUpdate(
            self._size,
            robot,
            np.full(count, self._version + ahead, np.uint32),
            indices.astype(np.int32),
            np.full(count, SHARED_LOG_ODDS_LIMIT * (-1) ** self._turn, np.int8),
            np.zeros((count, 2), np.uint64),
            _SESSION,
            sender,
        )
        return [("update", rows) for rows in encode_update(update, _MESSAGE)]

    def _other(self) -> int:
        return int(self._rng.integers(LIAR))

    def _next(self) -> int:
        self._number += 1
        return self._number


class HostileNetwork(TeamNetwork):
    """Four robots, of which the last one lies.

    Args:
        team: how the others share.
        voxel_size: [m].
        memory_limit: of each replica [GB].
        lies: bytes that the last one sends on average [bytes/s]; 0: it is silent.
        seed: of all that is random; with the same one, the others see the same.

    Attributes:
        liar: the last one.
        refused: messages that the others refused, by reason.
    """

    def __init__(
        self, team: TeamConfig, voxel_size: float, memory_limit: float, lies: float, seed: int
    ) -> None:
        radio = Radio(rate=1e9, loss=0.0)
        super().__init__(LIAR + 1, radio, team, voxel_size, seed, memory_limit=memory_limit)
        self._channel = Channel(LIAR + 1, radio, np.random.default_rng(seed))  # none of the views'
        sessions = [robot.member.session for robot in self.robots]
        self.liar = Liar(sessions, voxel_size, lies, seed)
        self.honest = self.robots[:LIAR]
        self.refused: Counter[str] = Counter()

    def hashes(self) -> list[tuple[int, ...]]:
        """Hash of each honest contribution, as each honest robot holds it."""
        held = [
            [robot.member.replica.contribution(number) for number in range(LIAR)]
            for robot in self.honest
        ]
        return [tuple(0 if part is None else part.hash() for part in parts) for parts in held]

    @property
    def is_settled(self) -> bool:
        """Whether all that the honest robots saw is sent, and known to all of them."""
        waiting = [len(changed_blocks(robot.own._storage)[0]) for robot in self.honest]
        return not any(waiting) and len(set(self.hashes())) == 1

    def liars_blocks(self) -> int:
        """Blocks that an honest robot keeps of the liar, at the most."""
        parts = [robot.member.replica.contribution(LIAR) for robot in self.honest]
        return max((part.blocks for part in parts if part is not None), default=0)

    def speak(self, number: int, digests: bool) -> Messages:
        """The liar lies; the others say what they have to."""
        return self.liar.speak(self.now) if number == LIAR else super().speak(number, digests)

    def receive(self, receiver: int, kind: str, rows: Rows) -> None:
        """As the nodes do: what is refused is counted."""
        if receiver == LIAR:
            self.liar.receive(kind, rows)
            return
        try:
            super().receive(receiver, kind, rows)
        except InfomapError as error:
            reason = error.reason if isinstance(error, UpdateRefusedError) else type(error).__name__
            self.refused[reason] += 1


@dataclass(frozen=True)
class HostileOutcome:
    """What has become of the honest robots.

    Attributes:
        hashes: of each honest contribution, as each honest robot holds it.
        memory: of the largest replica at any time [bytes].
        liars_blocks: blocks of the liar that are kept, at the most.
        seconds: processor time for sharing, all honest robots [s].
        refused: messages that they refused, by reason.
        sent: messages of the liar, by kind.
        end: time until the honest replicas were the same after the last view [s].
    """

    hashes: list[tuple[int, ...]]
    memory: int
    liars_blocks: int
    seconds: float
    refused: Counter[str]
    sent: Counter[str]
    end: float


def run_with_liar(
    seconds: float,
    lies: float,
    *,
    period: float = 0.5,
    voxel_size: float = 0.1,
    bandwidth: float = 0.5,
    memory_limit: float = 0.1,
    seed: int = 0,
) -> HostileOutcome:
    """Let three robots map a hall beside a fourth that lies.

    Args:
        seconds: how long they map, simulated [s].
        lies: what the fourth sends [MB/s]; 0: it is silent.
        period: time between two views of a robot [s].
        voxel_size: [m].
        bandwidth: of each honest robot [MB/s].
        memory_limit: of each replica [GB].
        seed: of the hall, the views and the lies.
    """
    config = TeamConfig(bandwidth=bandwidth, message_size=_MESSAGE, recovery=_RECOVERY)
    network = HostileNetwork(config, voxel_size, memory_limit, 1e6 * lies, seed)
    views = memory = 0
    while network.now < seconds or (
        not network.is_settled and network.now < seconds + _LONGEST_END
    ):
        if views * period <= network.now < seconds:
            views += 1
            for robot in network.honest:
                network.look(robot)
        network.step()
        held = [robot.member.replica.memory_bytes() for robot in network.honest]
        memory = max(memory, *held)
    return HostileOutcome(
        network.hashes(),
        memory,
        network.liars_blocks(),
        sum(robot.seconds for robot in network.honest),
        network.refused,
        network.liar.counts,
        network.now - seconds,
    )
