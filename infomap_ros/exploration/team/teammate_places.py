"""Where teammates were at a time, and which points of a scan lie on their bodies.

It is interpolated between what they sent before and after. Where that is not known, a teammate is
within its speed times the time of where it was.

Teammates' bodies in a scan, so that no robot maps another.

A robot that stood in view before it reported, or while it was forgotten, was a part of the scene
until then: when it reports again, its body is taken out of what was fused (`take_arrivals`).

A teammate's solids, or the upright cylinder about all of them where these are not known, are grown
by how far it may have moved since it reported its place, by the body filter's margin, and by the
standard deviation of where the teammate is for this camera.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import PoseUnavailableError, RobotModelError
from infomap_ros.geometry import (
    Cylinder,
    JointStateRecord,
    PlacedSolid,
    PoseBuffer,
    PoseBufferConfig,
    PoseRecord,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.team.agents import Agent
from infomap_ros.team.update import are_one_frame


@dataclass(frozen=True, eq=False)
class BodyInScan:
    """A teammate's body.

    Attributes:
        robot: its id.
        solids: placed in the camera's frame.
        margin: by which they are to be grown [m].
        is_sure: whether it is known where it was at the scan's stamp.
        ground: (n, d), shape (4,): what lies at p with ``n . p < d`` [m] is its ground;
            None where it is of no matter.
    """

    robot: int
    solids: Sequence[PlacedSolid]
    margin: float
    is_sure: bool
    ground: FloatArray | None = None


def on_bodies(
    points: ArrayLike,
    covariances: ArrayLike | None,
    bodies: Sequence[BodyInScan],
    config: BodyFilterConfig,
) -> NDArray[np.bool_]:
    """Mark the points of a scan that may lie on one of several bodies.

    Args:
        points: shape (..., 3), camera frame [m].
        covariances: as `mapping.scans.body.body_mask` takes them.
        bodies: placed in the camera's frame, each with its margin.
        config: how points' errors count.
    """
    mask = np.zeros(np.shape(points)[:-1], np.bool_)
    for body in bodies:
        grown = replace(config, margin=body.margin)
        mask |= body_mask(points, covariances, body.solids, grown)
    return mask


def largest_variance(covariance: FloatArray, lever: float) -> float:
    """Largest variance of a point at a lever [m] from a pose's origin, from above [m^2]."""
    position = np.linalg.eigvalsh(covariance[:3, :3])[-1]
    rotation = np.linalg.eigvalsh(covariance[3:, 3:])[-1]
    # Whatever the two have to do with each other, the deviations add at the most.
    return float((np.sqrt(max(position, 0.0)) + lever * np.sqrt(max(rotation, 0.0))) ** 2)


def cylinder_about(agent: Agent, growth: float) -> PlacedSolid:
    """The cylinder about a robot's body, grown, in the frame of its base."""
    height = max(agent.top - agent.bottom, 0.01) + 2.0 * growth
    middle = make_transform(np.eye(3), (0.0, 0.0, 0.5 * (agent.top + agent.bottom)))
    return PlacedSolid(Cylinder(agent.radius + max(growth, 0.01), height), middle, "robot")


_MOST_AROUND = 0.3  # [m] about a teammate where no fiducials are chosen: others are needed
_RECENT = 10  # messages whose postures count for the cylinder about a teammate
_NANOSECONDS = 1e9
_MAX_GAP = 0.6  # between two messages of a teammate across which its place is interpolated [s]
# How fast any part of a teammate moves at the most: so much its body grows for each second for
# which it is not known where it was [m/s].
_SPEED = 0.7
_MAX_GROWTH = 1.5  # it grows no further by that: it is taken to have stopped [m]
_UNKNOWN_SIGMA = 0.1  # of the place of a teammate that does not report it [m]


@dataclass(frozen=True, eq=False)
class Place:
    """Where a teammate was at a time.

    Attributes:
        pose: of its base in the map.
        joints: positions by name [rad or m].
        growth: how far it may have been from there, as that was reported for another time [m].
        is_sure: whether it is known for that time.
    """

    pose: PoseRecord
    joints: dict[str, float]
    growth: float = 0.0
    is_sure: bool = True


class _Track:
    """What one teammate has reported of late."""

    def __init__(self) -> None:
        self.poses = PoseBuffer(PoseBufferConfig(max_gap=_MAX_GAP, capacity=100))
        self.joints = JointBuffer(JointBufferConfig(max_gap=_MAX_GAP, capacity=100))
        self.recent: deque[Agent] = deque(maxlen=_RECENT)

    def add(self, agent: Agent) -> None:
        self.recent.append(agent)
        self.poses.add(PoseRecord(agent.stamp, "map", agent.T_map_base, agent.covariance))
        names = tuple(agent.joints)
        positions = np.array([agent.joints[name] for name in names], dtype=np.float64)
        self.joints.add(JointStateRecord(agent.stamp, "", names, positions))

    def about(self, growth: float) -> PlacedSolid:
        """The cylinder about its body in all postures of late, grown, in the frame of its base."""
        largest = replace(
            self.recent[-1],
            radius=max(agent.radius for agent in self.recent),
            bottom=min(agent.bottom for agent in self.recent),
            top=max(agent.top for agent in self.recent),
        )
        return cylinder_about(largest, growth)


class TeammatePlaces:
    """Remembers where each teammate reported that it was.

    Args:
        body: how much what is about them is grown.
    """

    def __init__(self, body: BodyFilterConfig | None = None) -> None:
        self._body = body or BodyFilterConfig()
        self._tracks: dict[int, _Track] = {}

    def receive(self, agent: Agent) -> None:
        """A teammate has reported where it is; where it was in another frame is forgotten."""
        if (track := self._tracks.get(agent.robot)) and track.recent[-1].origin != agent.origin:
            del self._tracks[agent.robot]
        self._tracks.setdefault(agent.robot, _Track()).add(agent)

    def keep(self, robots: Collection[int]) -> list[Agent]:
        """Forget all robots but these; returns what the forgotten ones reported last."""
        gone = self._tracks.keys() - set(robots)
        return [self._tracks.pop(robot).recent[-1] for robot in sorted(gone)]

    @property
    def agents(self) -> dict[int, Agent]:
        """What each teammate reported last, by its id."""
        return {robot: track.recent[-1] for robot, track in sorted(self._tracks.items())}

    def reported_at(self, robot: int, stamp: int) -> Place:
        """Where a teammate was, as it reported it.

        Args:
            robot: its id.
            stamp: [ns].

        Raises:
            PoseUnavailableError: it is not reported; its `may_arrive` says whether it still may be.
        """
        if robot not in self._tracks:
            text = f"nothing was received of robot {robot}"
            raise PoseUnavailableError(text, "place of a teammate", may_arrive=True)
        track = self._tracks[robot]
        agent = track.recent[-1]
        if agent.since <= stamp <= agent.stamp:
            pose = PoseRecord(stamp, "map", agent.T_map_base, agent.covariance)
            return Place(pose, dict(agent.joints))
        pose = track.poses.at(stamp)
        return Place(pose, track.joints.at(stamp) if len(track.joints) else {})

    def place(self, robot: int, stamp: int) -> Place:
        """Where a teammate was that has reported, or where it reported to be nearest in time.

        Args:
            robot: its id.
            stamp: [ns].
        """
        try:
            return self.reported_at(robot, stamp)
        except PoseUnavailableError:
            agent = self._tracks[robot].recent[-1]
            pose = PoseRecord(agent.stamp, "map", agent.T_map_base, agent.covariance)
            away = abs(stamp - agent.stamp) / _NANOSECONDS
            growth = min(_SPEED * away, _MAX_GROWTH)
            return Place(pose, dict(agent.joints), growth, is_sure=False)

    def variance(self, pose: PoseRecord, lever: float) -> float:
        """Largest variance of a point of a teammate's body at a lever [m] from its base [m^2]."""
        if pose.covariance is None:
            return _UNKNOWN_SIGMA**2
        return largest_variance(pose.covariance, lever)

    def about(self, stamp: int, origin: int = 0) -> list[PlacedSolid]:
        """An upright cylinder about each teammate, in which any of it was at a time.

        A teammate that is silent or lost takes no more room than `_MOST_AROUND` about its body.

        Args:
            stamp: [ns].
            origin: names the frame of the map; teammates in others are left out.

        Returns:
            Placed in the map, grown as the solids are for a scan, but for the error of its pose.
        """
        cylinders = []
        for robot, agent in self.agents.items():
            if not are_one_frame(agent.origin, origin):
                continue
            place = self.place(robot, stamp)
            sigma = float(np.sqrt(self.variance(place.pose, agent.radius)))
            margin = self._body.margin + place.growth + self._body.sigmas * sigma
            about = self._tracks[robot].about(min(margin, _MOST_AROUND))
            transform = place.pose.transform @ about.transform
            cylinders.append(PlacedSolid(about.solid, transform, about.name))
        return cylinders


_MOST_MARGIN = 1.0  # [m]; solids that would have to grow by more are replaced by the cylinder
_OVER_GROUND = 0.03  # [m]; what is no higher than this over a body's lowest point is its ground
_SURE_MARGIN = 0.15  # [m]; of a body that is taken out of what was fused
# How long a scan waits until it is known where teammates were at its stamp, in time of the data.
_WAIT = 0.5 * _NANOSECONDS


class TeamBodies(TeammatePlaces):
    """Knows also what teammates' bodies are, for the scans of one robot.

    Args:
        body: how much bodies are grown.
    """

    def __init__(self, body: BodyFilterConfig | None = None) -> None:
        super().__init__(body)
        self._models: dict[int, RobotModel] = {}
        self._before: dict[int, Agent] = {}
        self._arrived: set[int] = set()

    def describe(self, robot: int, model: RobotModel) -> None:
        """What a teammate's body is: with its base frame, as it reports its pose."""
        self._models[robot] = model

    def is_described(self, robot: int) -> bool:
        """Whether a teammate's solids are known."""
        return robot in self._models

    def keep(self, robots: Collection[int]) -> list[Agent]:
        """Forget all robots but these; returns what the forgotten ones reported last."""
        gone = super().keep(robots)
        self._before |= {agent.robot: agent for agent in gone}
        self._models = {robot: self._models[robot] for robot in self._models if robot in robots}
        self._arrived &= set(robots)
        return gone

    def take_arrivals(self) -> list[BodyInScan]:
        """Bodies of teammates that report for the first time, or again, in the map's frame.

        Each is returned once, when its solids are known and it is known where it is. Where it stood
        when it reported last counts, too.
        """
        bodies = []
        for robot, agent in self.agents.items():
            if robot in self._arrived or robot not in self._models:
                continue
            if (body := self._in_map(agent)).margin <= _SURE_MARGIN:
                self._arrived.add(robot)
                bodies.append(body)
                if (before := self._before.pop(robot, None)) is not None:
                    bodies.append(self._in_map(before))
        return bodies

    def check_known_at(self, stamp: int, newest: int, robots: Collection[int]) -> None:
        """Make sure that nothing more need be waited for.

        Args:
            stamp: of a scan [ns].
            newest: time of the newest data [ns].
            robots: teammates that are present.

        Raises:
            PoseUnavailableError: it may still be reported where one was at that time.
        """
        if newest - stamp >= _WAIT:
            return
        for robot in self.agents.keys() & set(robots):
            try:
                self.reported_at(robot, stamp)
            except PoseUnavailableError as error:
                if error.may_arrive:
                    text, reason = f"robot {robot}: {error}", "place of a teammate"
                    raise PoseUnavailableError(text, reason, may_arrive=True) from error

    def bodies_in(self, camera: PoseRecord) -> list[BodyInScan]:
        """All teammates' bodies, placed for a scan.

        Args:
            camera: pose of the optical frame in the map, at the scan's stamp.
        """
        return [self._placed(agent, camera) for agent in self.agents.values()]

    def _placed(self, agent: Agent, camera: PoseRecord) -> BodyInScan:
        place = self.place(agent.robot, camera.stamp)
        sigma = self._sigma(agent, place.pose, camera)
        margin = self._body.margin + place.growth + self._body.sigmas * sigma
        T_camera_base = invert_transform(camera.transform) @ place.pose.transform
        solids = self._solids(agent.robot, place.joints) if margin <= _MOST_MARGIN else []
        if not solids:
            solids, margin = [cylinder_about(agent, margin)], 0.0
        placed = [PlacedSolid(s.solid, T_camera_base @ s.transform, s.name) for s in solids]
        return BodyInScan(agent.robot, placed, margin, place.is_sure)

    def _in_map(self, agent: Agent) -> BodyInScan:
        """A teammate's body in the map as reported, the frame of the map in place of a camera."""
        pose = PoseRecord(agent.stamp, "map", agent.T_map_base, agent.covariance)
        margin = self._body.margin + self._body.sigmas * self._sigma(
            agent, pose, PoseRecord(agent.stamp, "map", np.eye(4))
        )
        placed = [
            PlacedSolid(s.solid, agent.T_map_base @ s.transform, s.name)
            for s in self._solids(agent.robot, dict(agent.joints))
        ]
        up, lowest = agent.T_map_base[:3, 2], np.array([0.0, 0.0, agent.bottom, 1.0])
        level = float(up @ (agent.T_map_base @ lowest)[:3]) + _OVER_GROUND
        return BodyInScan(agent.robot, placed, margin, True, np.array([*up, level]))

    def _solids(self, robot: int, joints: dict[str, float]) -> list[PlacedSolid]:
        """Solids in the frame of the base; none where they are not known."""
        if (model := self._models.get(robot)) is None:
            return []
        try:
            return model.solids_in(model.base_frame, joints)
        except RobotModelError:
            return []

    def _sigma(self, agent: Agent, pose: PoseRecord, camera: PoseRecord) -> float:
        """Bound of the standard deviation of where a body is for the camera [m]."""
        distance = float(np.linalg.norm(pose.transform[:3, 3] - camera.transform[:3, 3]))
        arm = np.linalg.norm(agent.T_map_camera[:3, 3] - agent.T_map_base[:3, 3])
        theirs = self.variance(pose, agent.radius + float(arm))
        own = 0.0 if camera.covariance is None else largest_variance(camera.covariance, distance)
        return float(np.sqrt(theirs + own))
