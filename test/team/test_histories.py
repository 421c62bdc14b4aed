"""Whatever happens on the way, a team ends with one map: loss, repetition, order, restarts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from infomap_ros.errors import UpdateRefusedError
from infomap_ros.mapping import NOT_OBSERVED, VoxelMap, VoxelMapConfig
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.digest import REPEATED
from infomap_ros.team.member import TeamMember
from infomap_ros.team.membership import PUBLISHES_ITSELF, TWO_OF_A_NAME
from infomap_ros.team.update import MapUpdate

CONFIG = VoxelMapConfig(voxel_size=0.1, max_range=3.0)
TEAM = TeamConfig(message_size=1000, silence=2.0, recovery=3.0)
ROBOTS = 3
Message = tuple[str, int, np.ndarray]


def empty_map() -> VoxelMap:
    made = VoxelMap(CONFIG)
    made.track_changes(True)
    return made


@dataclass
class Robot:
    """A robot, its map, what waits for it on the network, and the file of its map."""

    number: int
    member: TeamMember
    own: VoxelMap = field(default_factory=empty_map)
    inbox: list[Message] = field(default_factory=list)
    saved: dict[str, np.ndarray] | None = None

    def look(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        points = np.column_stack([rng.uniform(-0.5, 0.5, (20, 2)), np.full(20, 1.0)])
        pose = np.eye(4)
        pose[:3, 3] = rng.uniform(-0.6, 0.6, 3)
        self.own.integrate(points, pose)

    def receive(self, message: Message, now: float) -> None:
        kind, _, rows = message
        member = self.member
        receive = {"digest": member.receive_digest, "request": member.receive_request}
        receive.get(kind, member.receive_update)(rows, now)

    @property
    def is_told(self) -> bool:
        """Whether all that this robot saw is told."""
        part = self.member.replica.contribution(self.number)
        told = {} if part is None else states(part.states(self.number))
        own = told_by(self.own, self.number)
        return {v: s[0] for v, s in told.items()} == {v: s[0] for v, s in own.items()}

    def say(self, now: float) -> list[Message]:
        told = [("update", self.number, rows) for rows in self.member.updates(self.own, now)]
        told += [("digest", self.number, rows) for rows in self.member.digests(now)]
        return told + [("request", self.number, rows) for rows in self.member.requests(now)]


class Team:
    """Robots that start, end and speak; who gets which message is for the test to say."""

    def __init__(self, clocks: tuple[int, ...] = (1000, 2**32 - 4, 5)) -> None:
        self.now, self.sessions, self.may_be_late = 0.0, 0, True
        self.clocks = clocks
        self.robots = [self.start(number) for number in range(ROBOTS)]

    def start(self, number: int) -> Robot:
        self.sessions += 1
        clock = self.clocks[number]
        return Robot(number, TeamMember(number, self.sessions, clock, CONFIG, TEAM))

    def restart(self, number: int) -> None:
        """Kill a robot; it begins again with the map that it last saved, or with none."""
        old = self.robots[number]
        self.robots[number] = robot = self.start(number)
        robot.saved = old.saved
        if old.saved is not None:
            robot.own = VoxelMap.from_state(CONFIG, old.saved)
            robot.own.track_changes(True)

    def step(self, passes: list[bool]) -> None:
        """Everybody speaks; `passes` says in turn which messages arrive."""
        self.now += 0.3
        number = 0
        for robot in self.robots:
            for message in robot.say(self.now):
                for other in self.robots:
                    if other is not robot:
                        number += 1
                        if not passes or passes[number % len(passes)]:
                            other.inbox.append(message)

    def deliver(self, order: int) -> None:
        rng = np.random.default_rng(order)
        for robot in self.robots:
            inbox, robot.inbox = robot.inbox, []
            for place in rng.permutation(len(inbox)):
                for _ in range(rng.choice([1, 1, 1, 2])):
                    try:
                        robot.receive(inbox[place], self.now)
                    except UpdateRefusedError as error:  # so late that it seems another robot's
                        allowed = (TWO_OF_A_NAME,) if self.may_be_late else ()
                        assert error.reason in (REPEATED, PUBLISHES_ITSELF, *allowed)

    def settle(self) -> None:
        """A network without loss, until all hold the same; fails where that never happens."""
        self.deliver(1)
        self.may_be_late = False
        end = self.now + TEAM.recovery
        for _ in range(150):
            self.step([])
            self.deliver(0)
            hashes = {robot.member.replica.hash() for robot in self.robots}
            if self.now > end and len(hashes) == 1 and all(r.is_told for r in self.robots):
                return
        raise AssertionError("the replicas stay different")


def told_by(own: VoxelMap, robot: int) -> dict[tuple[int, ...], tuple[int, bytes]]:
    """What a map is when it is told."""
    copy = VoxelMap.from_state(CONFIG, own.state())
    copy.track_changes(True)
    copy.mark_changed(0, 10**6)
    return states(MapUpdate.of_changes(copy.take_changes(), 0.1, robot, 1))


def states(update: MapUpdate) -> dict[tuple[int, ...], tuple[int, bytes]]:
    known = np.flatnonzero(update.log_odds != NOT_OBSERVED)
    return {
        tuple(update.indices[row].tolist()): (
            int(update.log_odds[row]),
            update.codes[row].tobytes(),
        )
        for row in known
    }


actions = st.one_of(
    st.tuples(st.just("look"), st.integers(0, ROBOTS - 1), st.integers(0, 2**20)),
    st.tuples(st.just("speak"), st.lists(st.booleans(), min_size=1, max_size=7)),
    st.tuples(st.just("deliver"), st.integers(0, 2**20)),
    st.tuples(st.just("save"), st.integers(0, ROBOTS - 1)),
    st.tuples(st.just("restart"), st.integers(0, ROBOTS - 1)),
)


@settings(deadline=None, max_examples=15)
@given(history=st.lists(actions, min_size=5, max_size=25))
def test_after_any_history_all_replicas_are_the_same_and_hold_what_the_robots_saw(
    history: list[tuple],
) -> None:
    team = Team()
    for action in history:
        if action[0] == "look":
            team.robots[action[1]].look(action[2])
        elif action[0] == "speak":
            team.step(action[1])
        elif action[0] == "deliver":
            team.deliver(action[1])
        elif action[0] == "save":
            robot = team.robots[action[1]]
            robot.saved = robot.own.state()
        else:
            team.restart(action[1])

    team.settle()

    assert len({robot.member.replica.hash() for robot in team.robots}) == 1
    assert all(robot.is_told for robot in team.robots)
