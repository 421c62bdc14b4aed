"""A team of which one member lies: what the others' map is, beside that without it.

The liar holds the key, as far as the team has one, and is on its list: it tells in its own name
whatever a member can tell. It maps nothing. In turn it

- fills the memory with voxels that it has not seen, at the rate that its bandwidth allows;
- tells digests of blocks that do not exist, and summaries of robots that do not exist;
- says that the others have told versions far ahead, and hands on states with such versions;
- hands back states to the others that they have not told;
- asks for everything, again and again, and repeats what the others have said and asked.

It begins when the others have recovered from their start: until then a robot believes what others
know of its past.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InfomapError, UpdateRefusedError
from infomap_ros.mapping import SHARED_LOG_ODDS_LIMIT
from infomap_ros.mapping.voxels.changes import changed_blocks
from infomap_ros.simulation.company.radio import Channel, Radio
from infomap_ros.studies.team.team_network import TeamNetwork
from infomap_ros.team import MapUpdate, TeamConfig, encode_update
from infomap_ros.team.digest import SUMMARY_ROW, CellDigest, Request, Summary
from infomap_ros.team.sent import message_bytes

LIAR = 3
_PERIOD = 0.5  # [s] between two views
_RECOVERY = 1.0  # [s]
_SESSION = 666
_ROWS = 1000  # of a message
Rows = NDArray[np.void]
Told = list[tuple[str, Rows]]


class Liar:
    """Makes the messages of a hostile member.

    Args:
        robots: how many there are, it included.
        sessions: those of the others, which it has heard.
        voxel_size: [m].
        bandwidth: bytes that it tells on average [bytes/s].
        seed: of what it makes up.
    """

    def __init__(
        self, robots: int, sessions: list[int], voxel_size: float, bandwidth: float, seed: int
    ) -> None:
        self._robots, self._sessions, self._size = robots, sessions, voxel_size
        self._bandwidth, self._rng = bandwidth, np.random.default_rng(seed)
        self._number, self._version, self._turn, self._sent = 0, 1000, 0, 0.0
        self._recorded: Told = []
        self.told: Counter[str] = Counter()

    def record(self, kind: str, rows: Rows) -> None:
        """Keep what another one has said, to repeat it."""
        self._recorded = [*self._recorded[-50:], (kind, rows)]

    def tell(self, now: float) -> Told:
        """What it tells until a time [s]: one kind of lie after another, as long as it may."""
        lies: tuple[Callable[[], Told], ...] = (
            self._fill, self._digest, self._summary, self._hand_on, self._ask, self._repeat,
        )  # fmt: skip
        told: Told = []
        while self._sent < self._bandwidth * (now - _RECOVERY):
            lie = lies[self._turn % len(lies)]
            self._turn += 1
            made = lie()
            told += made
            self._sent += max(1000, sum(message_bytes(rows) for _, rows in made))
            self.told[lie.__name__.strip("_")] += len(made)
        return told

    def _other(self) -> int:
        return int(self._rng.integers(self._robots - 1))

    def _next(self, count: int = 1) -> int:
        self._number += count
        return self._number

    def _update(self, robot: int, indices: NDArray[np.int64], ahead: int, lies: bool) -> Told:
        self._version += 1
        count = len(indices)
        update = MapUpdate(
            self._size,
            robot,
            np.full(count, (self._version + ahead) % 2**32, np.uint32),
            indices.astype(np.int32),
            np.full(count, SHARED_LOG_ODDS_LIMIT * (-1) ** self._turn, np.int8),
            np.zeros((count, 2), np.uint64),
            _SESSION,
            LIAR if lies else None,
        )
        return [("update", rows) for rows in encode_update(update, 60_000)]

    def _fill(self) -> Told:
        """One voxel of each of many blocks far from where the others are."""
        low = np.array([4096, 0, 0]) + 256 * self._rng.integers(0, 100, 3)
        return self._update(LIAR, low + 8 * self._rng.integers(0, 32, (_ROWS, 3)), 0, False)

    def _digest(self) -> Told:
        corners = np.unique(self._rng.integers(-1000, 1000, (_ROWS, 3)), axis=0).astype(np.int32)
        hashes = np.full(len(corners), 1, np.uint32)
        robot, serial = int(self._rng.integers(self._robots)), int(self._rng.integers(2**31))
        about = LIAR, _SESSION, robot, self._version, serial, 0, corners, hashes
        return [("digest", rows) for rows in CellDigest(*about).encode(60_000, self._next())]

    def _summary(self) -> Told:
        rows = np.zeros(1000, SUMMARY_ROW)
        rows["robot"], rows["hash"] = np.arange(1000), 3
        rows["newest"] = self._rng.choice([1000 + 2**31 - 2, 2**30, 2**24], 1000)
        return [("digest", Summary(LIAR, _SESSION, rows).encode(self._next()))]

    def _hand_on(self) -> Told:
        """States of the others, where they map, as they have never told them."""
        box = self._rng.integers(-100, 100, (_ROWS, 3))
        return self._update(
            self._other(), box, int(self._rng.choice([0, 5000, 2**31 - 2000])), True
        )

    def _ask(self) -> Told:
        other, wants = self._other(), ("cells", "states")[self._turn // 6 % 2]
        who = LIAR, _SESSION, other, self._sessions[other], self._other()
        request = Request(*who, wants, 0, 0, np.empty((0, 3), np.int32))
        return [("request", rows) for rows in request.encode(60_000, self._next())]

    def _repeat(self) -> Told:
        return list(self._recorded)


@dataclass(frozen=True)
class Outcome:
    """What has become of the honest robots.

    Attributes:
        hashes: of each honest robot's contribution, as each of them holds it.
        memory: of the largest replica [bytes].
        liars_blocks: blocks of the liar that are kept, at the most.
        seconds: processor time for sharing, all robots.
        dropped: what was refused, by reason.
        told: messages of the liar by kind.
        end: time until the honest replicas were the same after the last view [s].
    """

    hashes: list[list[int]]
    memory: int
    liars_blocks: int
    seconds: float
    dropped: Counter[str]
    told: Counter[str]
    end: float


def run(
    seconds: float,
    is_hostile: bool,
    *,
    voxel_size: float = 0.1,
    bandwidth: float = 0.5,
    memory_limit: float = 0.06,
    seed: int = 0,
) -> Outcome:
    """Let three robots map a hall, with or without a fourth that lies.

    Args:
        seconds: how long they map, simulated [s].
        is_hostile: whether the fourth lies; otherwise it is silent.
        voxel_size: [m].
        bandwidth: of each [MB/s].
        memory_limit: of each replica [GB].
        seed: of the hall, the views and the lies.
    """
    config = TeamConfig(bandwidth=bandwidth, message_size=20_000, recovery=_RECOVERY)
    network = HostileNetwork(config, voxel_size, memory_limit, seed, is_hostile)
    views = 0
    while network.now < seconds:
        if network.now >= views * _PERIOD:
            views += 1
            for robot in network.robots[:LIAR]:
                network.look(robot)
        network.step()
    while not network.is_settled and network.now < seconds + 60.0:
        network.step()
    return Outcome(
        network.hashes(),
        max(robot.member.replica.memory_bytes() for robot in network.robots[:LIAR]),
        network.liars_blocks(),
        sum(robot.seconds for robot in network.robots[:LIAR]),
        network.dropped,
        network.liar.told,
        network.now - seconds,
    )


class HostileNetwork(TeamNetwork):
    """Four robots, of which the last one may lie.

    Args:
        team: how they share.
        voxel_size: [m].
        memory_limit: [GB].
        seed: of all that is random.
        is_hostile: whether it lies.
    """

    def __init__(
        self,
        team: TeamConfig,
        voxel_size: float,
        memory_limit: float,
        seed: int,
        is_hostile: bool,
    ) -> None:
        radio = Radio(rate=1e9, loss=0.0)
        super().__init__(4, radio, team, voxel_size, seed, memory_limit=memory_limit)
        self._channel = Channel(4, radio, np.random.default_rng(seed))  # views stay the same
        sessions = [robot.member.session for robot in self.robots]
        rate = 1e6 * team.bandwidth if is_hostile else 0.0
        self.liar = Liar(4, sessions, voxel_size, rate, seed)
        self.dropped: Counter[str] = Counter()

    def hashes(self) -> list[list[int]]:
        """Hash of each honest contribution, as each honest robot holds it."""
        parts = [
            [robot.member.replica.contribution(number) for number in range(LIAR)]
            for robot in self.robots[:LIAR]
        ]
        return [[0 if part is None else part.hash() for part in held] for held in parts]

    @property
    def is_settled(self) -> bool:
        """Whether all that the honest robots saw is told, and known to all of them."""
        waiting = [len(changed_blocks(robot.own._storage)[0]) for robot in self.robots[:LIAR]]
        return not any(waiting) and len(set(map(tuple, self.hashes()))) == 1

    def liars_blocks(self) -> int:
        """Blocks that are kept of the liar, at the most."""
        parts = [robot.member.replica.contribution(LIAR) for robot in self.robots[:LIAR]]
        return max((part.blocks for part in parts if part is not None), default=0)

    def speak(self, number: int, digests: bool) -> list[tuple[str, Rows]]:
        """The liar lies; the others say what they have to."""
        if number == LIAR:
            return self.liar.tell(self.now)
        return super().speak(number, digests)

    def hear(self, receiver: int, kind: str, rows: Rows) -> None:
        """As the nodes do: what is refused is counted."""
        if receiver == LIAR:
            self.liar.record(kind, rows)
            return
        try:
            super().hear(receiver, kind, rows)
        except InfomapError as error:
            reason = error.reason if isinstance(error, UpdateRefusedError) else type(error).__name__
            self.dropped[reason] += 1
