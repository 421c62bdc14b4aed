"""What a robot reports to its team of itself, and what it makes of what the others report.

Knows neither network nor clock: texts are carried by somebody, times are handed in. Several threads
may use it.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from infomap_ros.exploration.robot import RobotState, spaced
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.keep_out import Obstacle
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import body_extent
from infomap_ros.team.agent_board import AgentBoard, agent_to_text
from infomap_ros.team.agents import Agent, AgentsConfig, knows
from infomap_ros.team.membership import TeamKey
from infomap_ros.team.own_version import OwnVersion
from infomap_ros.views.situation import Teammate

_MOST_WAYPOINTS = 60
_LONGEST_STATE = 80
ANNOUNCE_PERIOD = 0.2
"""Time between two messages about a robot, in time of the data [s]."""
_GOAL_TIME = 300.0  # after which a claimed goal is given up, in time of the data [s]
_MOVED, _TURNED = 0.01, 0.01  # a place [m] or angle [rad] that differs by more is another one


@dataclass(frozen=True, eq=False)
class Presence:
    """What a robot knows of itself.

    Attributes:
        stamp: of pose and joints [ns].
        state: where it is.
        robot: what it is.
        camera: its rectified left camera.
        max_range: how far it sees [m].
        doing: what it is doing, in words.
        description: full name of the topic of its robot_description; empty without one.
        description_hash: of the text on it, see `hash_of_description`.
        origin: names the frame of its map.
    """

    stamp: int
    state: RobotState
    robot: RobotModel
    camera: PinholeCamera
    max_range: float
    doing: str = "idle"
    description: str = ""
    description_hash: str = ""
    origin: int = 0


class Word(NamedTuple):
    """What a robot reports of itself.

    Attributes:
        agent: what is sent.
        text: the same, signed, as it is sent.
    """

    agent: Agent
    text: str


@dataclass(frozen=True, eq=False)
class _Claim:
    """A goal view, the path to it, what was known of the others' claims, and when it was sent."""

    number: int
    goal: FloatArray | None = None
    path: FloatArray | None = None
    known: tuple[tuple[int, int], ...] = ()
    announced: int | None = None


class Teamwork:
    """One robot of a team, as far as it knows.

    Args:
        robot: id of this robot, unique in its team.
        session: number that it draws at each start, see `team.membership.draw_session`.
        version: newer than what it sent before, see `team.versions.version_at`.
        config: how robots learn of each other.
        team: ids of the robots that count; all if empty.
        key: of the team; without one every message is taken for genuine.
    """

    def __init__(
        self,
        robot: int,
        session: int,
        version: int,
        config: AgentsConfig | None = None,
        team: Collection[int] = (),
        key: TeamKey | None = None,
    ) -> None:
        self.robot, self.config = robot, config or AgentsConfig()
        self._session, self._version, self._key = session, OwnVersion(version), key
        self._board = AgentBoard(robot, session, team, key)
        self._claim = _Claim(version)
        self._still: Presence | None = None
        self._lock = threading.Lock()

    def receive(self, text: str, now: float) -> Agent | None:
        """Learn what a robot reports of itself; None where it is not new.

        Raises:
            InvalidInputError: the text is malformed, or says something impossible.
            UpdateRefusedError: that robot must not write, or not that.
        """
        with self._lock:
            agent = self._board.receive(text, now, self._version.number)
            if agent is not None and self.robot in agent.claims:
                self._follow(agent.claims[self.robot], agent.robot, now)
            return agent

    def _follow(self, known: int, mate: int, now: float) -> None:
        """Go on after what a teammate knows of this robot from before its clock went back."""
        before = self._version.number
        self._version.follow(known, mate, now)
        if self._version.number != before:
            self._claim = replace(self._claim, number=self._version.number)

    def announcement(self, me: Presence) -> Word:
        """What to send the others now."""
        radius, bottom, top = body_extent(me.robot, me.state.joints)
        with self._lock:
            version, self._board.origin = self._version.advance(), me.origin
            claim, state = self._current_claim(me.stamp), me.state
            if self._still is None or _has_moved(self._still, me):
                self._still = me
            agent = Agent(
                self.robot,
                self._session,
                version,
                me.stamp,
                self._still.stamp,
                state.T_map_base,
                state.T_map_camera,
                state.pose_covariance,
                me.camera,
                me.max_range,
                me.doing[:_LONGEST_STATE],
                state.joints,
                claim.goal,
                np.empty((0, 3)) if claim.path is None else claim.path,
                claim.number,
                dict(claim.known) | self._board.past(),
                radius,
                bottom,
                top,
                me.description,
                me.description_hash,
                me.robot.base_frame,
                me.origin,
            )
        return Word(agent, agent_to_text(agent, self._key))

    def claim(self, goal: FloatArray, path: FloatArray, known: dict[int, int]) -> None:
        """From now on this robot is heading for a view.

        Args:
            goal: ``T_map_camera``, shape (4, 4).
            path: base poses (x, y, yaw) to it, shape (K, 3); those that matter are sent.
            known: claims of the others that were known when it was chosen, of `claims`.
        """
        step = max(1, -(-len(path) // _MOST_WAYPOINTS))
        waypoints = path[::step] if len(path) < 2 else np.concatenate([path[:-1:step], path[-1:]])
        with self._lock:
            self._claim = _Claim(self._version.advance(), goal, waypoints, tuple(known.items()))

    def give_up(self) -> None:
        """From now on this robot is heading for nothing."""
        with self._lock:
            if self._claim.goal is not None:
                self._claim = _Claim(self._version.advance())

    def _current_claim(self, stamp: int) -> _Claim:
        """The claim, without its goal where that was sent for the first time too long ago."""
        claim = self._claim
        announced = stamp if claim.announced is None else claim.announced
        if claim.goal is not None and stamp - announced > _GOAL_TIME * 1e9:
            claim = _Claim(self._version.number)
        self._claim = replace(claim, announced=announced)
        return self._claim

    @property
    def goal(self) -> FloatArray | None:
        """``T_map_camera`` of the view that this robot is heading for; None without one."""
        return self._claim.goal

    def claims(self, now: float) -> dict[int, int]:
        """Claims of the others that are known, by their ids."""
        with self._lock:
            return self._board.claims(now)

    def present(self, now: float) -> tuple[Agent, ...]:
        """The others that have reported lately."""
        with self._lock:
            return self._board.present(now)

    def claims_since(self, known: dict[int, int], now: float) -> tuple[Agent, ...]:
        """The others that have claimed another goal since `known`, of `claims`."""
        agents = self.present(now)
        return tuple(a for a in agents if a.goal is not None and known.get(a.robot) != a.claim)

    def rivals(self, now: float) -> tuple[Agent, ...]:
        """The others whose claims go before this robot's present one.

        Neither knew of the other's when it chose, and theirs is the smaller id.
        """
        number = self._claim.number
        return tuple(
            agent
            for agent in self.present(now)
            if agent.goal is not None
            and agent.robot < self.robot
            and not knows(agent, self.robot, number)
            and dict(self._claim.known).get(agent.robot) != agent.claim
        )

    def teammates(self, now: float) -> tuple[Teammate, ...]:
        """The others as the choice of a view sees them."""
        present = {agent.robot for agent in self.present(now)}
        return tuple(
            teammate_of(agent if agent.robot in present else replace(agent, goal=None))
            for agent in self._remembered(now)
        )

    def obstacles(self, now: float, state: RobotState, robot: RobotModel) -> Sequence[Obstacle]:
        """The others' bodies, paths and places, as the motion of this robot sees them."""
        present = {agent.robot for agent in self.present(now)}
        radius = body_extent(robot, state.joints)[0]
        return [
            obstacle
            for agent in self._remembered(now)
            for obstacle in obstacles_of(
                agent, agent.robot in present, state.T_map_base[:2, 3], radius
            )
        ]

    def _remembered(self, now: float) -> tuple[Agent, ...]:
        with self._lock:
            return self._board.remembered(now)


def _has_moved(before: Presence, now: Presence) -> bool:
    """Whether a robot is another, stands elsewhere or otherwise; also where the clock went back."""
    if now.robot is not before.robot or now.stamp < before.stamp:
        return True
    first, second = before.state, now.state
    change = np.linalg.inv(first.T_map_base) @ second.T_map_base
    turn = np.linalg.norm(change[:3, :3] - np.eye(3)) / np.sqrt(2.0)
    joints = [abs(q - first.joints.get(name, np.inf)) for name, q in second.joints.items()]
    moved = np.linalg.norm(change[:3, 3]) > _MOVED or turn > _TURNED
    return bool(moved or max(joints, default=0.0) > _TURNED)


_CLEARANCE = 0.3  # between the bodies, and to the places where teammates are going [m]
_LEAST_SHARE = 0.5  # of a body's radius, however near one stands to it


def teammate_of(agent: Agent) -> Teammate:
    """A robot as the choice of a view sees it: the middle of its body, and what it will see."""
    base = agent.T_map_base
    middle = base[:3, 3] + 0.5 * (agent.bottom + agent.top) * base[:3, 2]
    stand = None
    if agent.goal is not None and len(agent.path):
        stand = np.array([*agent.path[-1, :2], middle[2]])
    return Teammate(middle, agent.goal, agent.max_range, agent.camera, agent.radius, stand)


def obstacles_of(
    agent: Agent, goes_on: bool, own_place: FloatArray, own_radius: float
) -> list[Obstacle]:
    """A robot's body, and the rest of the path that it has reported, as upright cylinders.

    They are grown by the clearance and by three standard deviations of its position; less where
    this robot stands within that already, as it must be able to leave.

    Args:
        agent: as it reported last.
        goes_on: whether it has reported lately, so that its path counts.
        own_place: x and y of this robot's base, shape (2,) [m, map].
        own_radius: of this robot's body about its base [m].
    """
    here = agent.T_map_base[:2, 3]
    places = [here]
    if goes_on and agent.goal is not None and len(agent.path):
        path = agent.path[:, :2]
        rest = path[int(np.linalg.norm(path - here, axis=1).argmin()) :]
        places += list(spaced(rest, 0.5 * max(agent.radius, 0.1)))
    bottom, top = agent.T_map_base[2, 3] + agent.bottom, agent.T_map_base[2, 3] + agent.top
    obstacles = []
    for number, place in enumerate(places):
        room = float(np.linalg.norm(place - own_place)) - own_radius
        least = _LEAST_SHARE * agent.radius if number == 0 else 0.0
        radius = max(min(agent.reach + _CLEARANCE, room), least)
        if radius > 0.0:
            x, y = float(place[0]), float(place[1])
            name = f"robot {agent.robot}" if number == 0 else f"the path of robot {agent.robot}"
            obstacles.append(Obstacle(x, y, radius, bottom, max(top, bottom + 0.1), name))
    return obstacles
