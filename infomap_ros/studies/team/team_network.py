"""Robots that map one hall and share it over a radio, all in one process.

Only the radio is simulated: scans are integrated, messages are those of the wire, and what is lost
stays lost unless the robots mend it themselves.

How far behind each other the maps of a team are.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import Box, PinholeCamera, PlacedSolid, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import LOG_ODDS_QUANTUM, SHARED_LOG_ODDS_LIMIT, VoxelMap, VoxelMapConfig
from infomap_ros.studies.noisy_scans import AnalyticScene
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.member import TeamMember
from infomap_ros.team.update import message_bytes

PACKET_BYTES, PACKET_OVERHEAD = 1400, 60


@dataclass(frozen=True)
class Radio:
    """The link of each robot to all others.

    Attributes:
        rate: at which a robot can send [bit/s].
        loss: share of the packets that a receiver does not get, independent of each other; a
            message with a lost packet is lost.
        delay: [s].
    """

    rate: float = 10e6
    loss: float = 0.2
    delay: float = 0.02


class Delivery(NamedTuple):
    """A message that has come.

    Attributes:
        receiver: number of the robot.
        kind: of the message, as its sender said.
        content: of the message.
    """

    receiver: int
    kind: str
    content: Any


class Channel:
    """Carries messages of any content between robots.

    Args:
        robots: how many; they have numbers from 0 on.
        radio: how the messages travel.
        rng: source of the losses.
    """

    def __init__(self, robots: int, radio: Radio, rng: np.random.Generator) -> None:
        self.radio, self._rng = radio, rng
        self._free_at, self._count = [0.0] * robots, 0
        self._on_air: list[tuple[float, int, Delivery]] = []

    def send(self, sender: int, kind: str, content: Any, size: int, now: float) -> None:
        """Send a message to all others; it begins when what was sent before is on air.

        Args:
            sender: number of the robot.
            kind: handed on.
            content: handed on.
            size: [bytes].
            now: [s].
        """
        radio, packets = self.radio, -(-size // PACKET_BYTES)
        duration = (size + packets * PACKET_OVERHEAD) * 8.0 / radio.rate
        self._free_at[sender] = max(self._free_at[sender], now) + duration
        for receiver in range(len(self._free_at)):
            arrives = self._rng.random() < (1.0 - radio.loss) ** packets
            if receiver != sender and arrives:
                self._count += 1
                due = self._free_at[sender] + radio.delay
                heapq.heappush(self._on_air, (due, self._count, Delivery(receiver, kind, content)))

    def deliver(self, now: float) -> Iterator[Delivery]:
        """Messages that have come by now [s], in their order."""
        while self._on_air and self._on_air[0][0] <= now:
            yield heapq.heappop(self._on_air)[2]

    def backlog(self, now: float) -> float:
        """How long what was sent still takes to be transmitted, at the most [s]."""
        return max(0.0, max(self._free_at) - now)


CAMERA = PinholeCamera(width=160, height=120, fx=130.0, fy=130.0, cx=79.5, cy=59.5)
_HALL = (24.0, 16.0, 3.0)  # [m]
_TICK = 0.05  # [s]
Rows = NDArray[np.void]


def make_hall(rng: np.random.Generator, boxes: int = 60) -> AnalyticScene:
    """A hall of 24 x 16 x 3 m with boxes of 0.3 to 1.5 m, none on the robots' path."""
    x, y, z = _HALL
    planes = [[0, 0, 1, 0], [0, 0, -1, -z]]
    planes += [[s, 0, 0, -x / 2] for s in (1, -1)] + [[0, s, 0, -y / 2] for s in (1, -1)]
    path = np.array([_place(angle) for angle in np.linspace(0.0, 2.0 * np.pi, 200)])
    solids: list[PlacedSolid] = []
    while len(solids) < boxes:
        size = rng.uniform(0.3, 1.5, 3)
        place = np.array([*rng.uniform([-x / 2, -y / 2], [x / 2, y / 2]), size[2] / 2])
        turn = Rotation.from_euler("z", rng.uniform(0, np.pi)).as_matrix()
        if np.linalg.norm(path[:, :2] - place[:2], axis=1).min() > 1.6:
            box = Box((float(size[0]), float(size[1]), float(size[2])))
            solids.append(PlacedSolid(box, make_transform(turn, place), f"box {len(solids)}"))
    return AnalyticScene(np.array(planes, np.float64), solids)


def _place(angle: float) -> FloatArray:
    """Where a camera is on its path through the hall, an ellipse 1.2 m above the floor [m]."""
    return np.array([8.0 * np.cos(angle), 4.5 * np.sin(angle), 1.2])


def view_pose(start: float, now: float) -> FloatArray:
    """T_map_camera (optical) of a robot that drives at about 0.3 m/s and looks left and right.

    Args:
        start: where on its path it began [rad].
        now: time since then [s].
    """
    angle = start + 0.3 * now / 6.5
    ahead = _place(angle + 1e-3) - _place(angle)
    yaw = np.arctan2(ahead[1], ahead[0]) + 0.8 * np.sin(2.0 * np.pi * now / 20.0)
    forward = np.array([np.cos(yaw), np.sin(yaw), -0.25])
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    return make_transform(axes, _place(angle))


@dataclass
class NetworkRobot:
    """A robot: its own map, its part of the team, and what it costs.

    Attributes:
        member: its part of the team.
        own: what it saw.
        sent: bytes that it sent, by kind of message, without those of the radio's packets.
        seconds: processor time for sharing, integrating not included [s].
        changed: number of changed voxels that it had to send.
    """

    member: TeamMember
    own: VoxelMap
    sent: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    changed: int = 0


class TeamNetwork:
    """Steps a team through time.

    Args:
        robots: how many.
        radio: the channel.
        team: how they share.
        voxel_size: [m].
        seed: of the hall, the views and the losses.
        max_range: to which robots map [m].
        memory_limit: of each map [GB].
    """

    def __init__(
        self,
        robots: int,
        radio: Radio,
        team: TeamConfig | None = None,
        voxel_size: float = 0.05,
        seed: int = 0,
        max_range: float = 5.0,
        memory_limit: float = VoxelMapConfig.memory_limit,
    ) -> None:
        self.radio, self.now = radio, 0.0
        self.config = VoxelMapConfig(
            voxel_size=voxel_size, max_range=max_range, memory_limit=memory_limit
        )
        self._team = team or TeamConfig()
        self._rng = np.random.default_rng(seed)
        self.scene = make_hall(self._rng)
        self.robots = [self.make_robot(number) for number in range(robots)]
        self._channel, self._digested = Channel(robots, radio, self._rng), 0.0

    def make_robot(self, number: int) -> NetworkRobot:
        """A robot that has seen nothing."""
        session = int(self._rng.integers(1, 2**32))
        member = TeamMember(number, session, 1000, self.config, self._team)
        own = VoxelMap(self.config)
        own.track_changes(True)
        return NetworkRobot(member, own)

    def look(self, robot: NetworkRobot) -> None:
        """Let a robot take a view from where it is."""
        start = 2.0 * np.pi * robot.member.robot / len(self.robots)
        pose = view_pose(start, self.now)
        depth = self.scene.depth_image(pose, CAMERA)
        points = CAMERA.back_project(depth).astype(np.float64)
        sigma = 0.004 * np.nan_to_num(depth, nan=1.0) ** 2
        rays = points / np.where(depth > 0.0, depth, np.nan)[..., None]
        noise = (sigma * self._rng.normal(size=depth.shape))[..., None] * rays
        spread = rays[..., :, None] * rays[..., None, :]
        covariances = (sigma**2)[..., None, None] * spread + (0.002**2) * np.eye(3)
        robot.own.integrate(points + noise, pose, covariances, 1e-6 * np.eye(6), CAMERA)

    def step(self) -> None:
        """Let `_TICK` seconds go by."""
        self.now += _TICK
        digests = self.now - self._digested >= self._team.digest_period
        self._digested = self.now if digests else self._digested
        for number, robot in enumerate(self.robots):
            start = time.thread_time()
            messages = self.speak(number, digests)
            robot.seconds += time.thread_time() - start
            for kind, rows in messages:
                self._send(number, robot, kind, rows)
        self._deliver()

    def speak(self, number: int, digests: bool) -> list[tuple[str, Rows]]:
        """What a robot says now, with or without digests, and of which kind it is."""
        robot = self.robots[number]
        member = robot.member
        messages = [("update", rows) for rows in member.updates(robot.own, self.now)]
        if digests:
            messages += [("digest", rows) for rows in member.digests(self.now)]
        return messages + [("request", rows) for rows in member.requests(self.now)]

    def receive(self, receiver: int, kind: str, rows: Rows) -> None:
        """A message has come to a robot."""
        member = self.robots[receiver].member
        handlers = {"digest": member.receive_digest, "request": member.receive_request}
        handlers.get(kind, member.receive_update)(rows, self.now)

    def run(self, seconds: float) -> None:
        """Let time go by."""
        for _ in range(round(seconds / _TICK)):
            self.step()

    @property
    def backlog(self) -> float:
        """How long what was sent still takes to be transmitted, at the most [s]."""
        return self._channel.backlog(self.now)

    def _send(self, number: int, robot: NetworkRobot, kind: str, rows: Rows) -> None:
        size = message_bytes(rows)
        robot.sent[kind] = robot.sent.get(kind, 0) + size
        self._channel.send(number, kind, rows, size, self.now)

    def _deliver(self) -> None:
        for receiver, kind, rows in self._channel.deliver(self.now):
            start = time.thread_time()
            self.receive(receiver, kind, rows)
            self.robots[receiver].seconds += time.thread_time() - start


LEAST_CHANGE = 0.02
"""Change of a probability that counts; less is what evidence near its limit still gains."""

_HALF = 1 << 15  # voxel indices stay below this


@dataclass(eq=False)
class _View:
    """Voxels to which a view gave other evidence, and who has not received all of them."""

    robot: int
    taken: float
    version: int
    indices: NDArray[np.int32]
    missing: set[int]


class LagMeter:
    """Measures for each view how long it takes until every other robot has all that it changed.

    Args:
        network: of the robots.

    Attributes:
        lags: of each view and receiver that has all of it [s].
    """

    def __init__(self, network: TeamNetwork) -> None:
        self._network = network
        self._views: list[_View] = []
        self.lags: list[float] = []

    @property
    def open(self) -> int:
        """Number of views of which somebody still misses something."""
        return len(self._views)

    def look(self, robot: NetworkRobot) -> None:
        """Let a robot take a view, and remember what it changed."""
        before = _evidence(robot)
        version = robot.member.version
        self._network.look(robot)
        after = _evidence(robot)
        indices = _changed(before, after)
        robot.changed += len(indices)
        others = set(range(len(self._network.robots))) - {robot.member.robot}
        view = _View(robot.member.robot, self._network.now, version, indices, others)
        self._views.append(view)

    def check(self) -> None:
        """Find out who has received which views; to be called after each step."""
        for view in self._views:
            for number in list(view.missing):
                part = self._network.robots[number].member.replica.contribution(view.robot)
                if part is not None and (part.versions_of(view.indices) > view.version).all():
                    view.missing.remove(number)
                    self.lags.append(self._network.now - view.taken)
        self._views = [view for view in self._views if view.missing]


def _evidence(robot: NetworkRobot) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Known voxels as single numbers, ascending, and their evidence as it is sent."""
    indices, log_odds = robot.own.voxels()
    limit = SHARED_LOG_ODDS_LIMIT
    quanta = np.clip(np.rint(log_odds / LOG_ODDS_QUANTUM), -limit, limit).astype(np.int64)
    x, y, z = indices.astype(np.int64).T + _HALF
    keys = (x * 2 * _HALF + y) * 2 * _HALF + z
    order = np.argsort(keys)
    return keys[order], quanta[order]


def _probability(quanta: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.asarray(1.0 / (1.0 + np.exp(-quanta * LOG_ODDS_QUANTUM)))


def _changed(
    before: tuple[NDArray[np.int64], NDArray[np.int64]],
    after: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> NDArray[np.int32]:
    """Voxels that are new, or whose probability changed by `LEAST_CHANGE`, shape (n, 3)."""
    keys, quanta = after
    same = np.zeros(len(keys), np.bool_)
    if len(before[0]):
        place = np.minimum(np.searchsorted(before[0], keys), len(before[0]) - 1)
        change = np.abs(_probability(before[1][place]) - _probability(quanta))
        same = (before[0][place] == keys) & (change < LEAST_CHANGE)
    rest, z = np.divmod(keys[~same], 2 * _HALF)
    return np.stack([*np.divmod(rest, 2 * _HALF), z], axis=-1).astype(np.int32) - _HALF
