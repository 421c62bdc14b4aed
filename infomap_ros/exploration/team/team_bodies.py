"""Teammates' bodies in a scan, so that no robot maps another.

Where a teammate was at a scan's stamp is interpolated between what it told before and after. Where
that is not known, it is within its speed times the time of where it was. Its solids, or the upright
cylinder about all of them where these are not known, are grown by that, by the body filter's
margin, and by the standard deviation of where the teammate is for this camera.
"""

from __future__ import annotations

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
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.motion import RobotModel
from infomap_ros.team.agents import Agent

_MOST_MARGIN = 1.0  # [m]; solids that would have to grow by more are replaced by the cylinder
_NANOSECONDS = 1e9


@dataclass(frozen=True)
class TeamBodiesConfig:
    """How teammates' bodies are found in scans.

    Raises:
        ConfigError: a value is out of its range.
    """

    wait: float = parameter(
        0.5,
        "How long a scan waits until it is known where teammates were at its stamp, in time of the "
        "data.",
        unit="s",
        low=0.0,
        high=10.0,
    )
    max_gap: float = parameter(
        0.6,
        "Longest time between two messages of a teammate across which its place is interpolated.",
        unit="s",
        low=0.0,
        high=10.0,
    )
    speed: float = parameter(
        0.7,
        "How fast any part of a teammate moves at the most: so much its body grows for each second "
        "for which it is not known where it was.",
        unit="m/s",
        low=0.0,
        high=100.0,
    )
    most_growth: float = parameter(
        1.5, "It grows no further by that: it is taken to have stopped.", unit="m", low=0.0,
        high=100.0,
    )  # fmt: skip
    unknown_sigma: float = parameter(
        0.1,
        "Standard deviation of the place of a teammate that does not tell it.",
        unit="m",
        low=0.0,
        high=10.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class BodyInScan:
    """A teammate's body.

    Attributes:
        robot: its id.
        solids: placed in the camera's frame.
        margin: by which they are to be grown [m].
        is_sure: whether it is known where it was at the scan's stamp.
    """

    robot: int
    solids: Sequence[PlacedSolid]
    margin: float
    is_sure: bool


class _Track:
    """Where one teammate was, and what it is."""

    def __init__(self, config: TeamBodiesConfig) -> None:
        self.poses = PoseBuffer(PoseBufferConfig(max_gap=config.max_gap, capacity=100))
        self.joints = JointBuffer(JointBufferConfig(max_gap=config.max_gap, capacity=100))
        self.robot: RobotModel | None = None
        self.agent: Agent | None = None

    def add(self, agent: Agent) -> None:
        self.agent = agent
        covariance = agent.covariance
        self.poses.add(PoseRecord(agent.stamp, "map", agent.T_map_base, covariance))
        names = tuple(agent.joints)
        positions = np.array([agent.joints[name] for name in names], dtype=np.float64)
        self.joints.add(JointStateRecord(agent.stamp, "", names, positions))

    def at(self, stamp: int) -> tuple[PoseRecord, dict[str, float]]:
        """Pose and joints at a time [ns].

        Raises:
            PoseUnavailableError: they are not known.
        """
        agent = self.agent
        if agent is not None and agent.since <= stamp <= agent.stamp:
            base, covariance = agent.T_map_base, agent.covariance
            return PoseRecord(stamp, "map", base, covariance), dict(agent.joints)
        pose = self.poses.at(stamp)
        return pose, self.joints.at(stamp) if len(self.joints) else {}


class TeamBodies:
    """Knows where teammates were, for the scans of one robot.

    Args:
        config: how they are found.
        body: how much bodies are grown.
    """

    def __init__(
        self, config: TeamBodiesConfig | None = None, body: BodyFilterConfig | None = None
    ) -> None:
        self.config, self._filter = config or TeamBodiesConfig(), body or BodyFilterConfig()
        self._tracks: dict[int, _Track] = {}

    def hear(self, agent: Agent) -> None:
        """A teammate has told where it is."""
        self._tracks.setdefault(agent.robot, _Track(self.config)).add(agent)

    def describe(self, robot: int, model: RobotModel) -> None:
        """What a teammate's body is: with its base frame, as it tells its pose."""
        self._tracks.setdefault(robot, _Track(self.config)).robot = model

    def is_described(self, robot: int) -> bool:
        """Whether a teammate's solids are known."""
        return robot in self._tracks and self._tracks[robot].robot is not None

    def keep(self, robots: Collection[int]) -> None:
        """Forget all robots but these."""
        for robot in self._tracks.keys() - set(robots):
            del self._tracks[robot]

    def check_known_at(self, stamp: int, newest: int, robots: Collection[int]) -> None:
        """Make sure that nothing more need be waited for.

        Args:
            stamp: of a scan [ns].
            newest: time of the newest data [ns].
            robots: teammates that are heard.

        Raises:
            PoseUnavailableError: it may still be told where one was at that time.
        """
        if newest - stamp >= self.config.wait * _NANOSECONDS:
            return
        for robot in robots:
            try:
                if robot in self._tracks:
                    self._tracks[robot].at(stamp)
            except PoseUnavailableError as error:
                if error.may_arrive:
                    text, reason = f"robot {robot}: {error}", "place of a teammate"
                    raise PoseUnavailableError(text, reason, may_arrive=True) from error

    def bodies_in(self, camera: PoseRecord) -> list[BodyInScan]:
        """All teammates' bodies, placed for a scan.

        Args:
            camera: pose of the optical frame in the map, at the scan's stamp.
        """
        heard = [(r, t) for r, t in sorted(self._tracks.items()) if t.agent is not None]
        return [self._placed(robot, track, camera) for robot, track in heard]

    def mask(
        self, points: ArrayLike, covariances: ArrayLike | None, camera: PoseRecord
    ) -> NDArray[np.bool_]:
        """Mark the points of a scan that may lie on a teammate; see `on_bodies`."""
        return on_bodies(points, covariances, self.bodies_in(camera), self._filter)

    def _placed(self, robot: int, track: _Track, camera: PoseRecord) -> BodyInScan:
        agent = track.agent
        assert agent is not None
        away = 0.0
        try:
            pose, joints = track.at(camera.stamp)
        except PoseUnavailableError:
            pose = PoseRecord(agent.stamp, "map", agent.T_map_base, agent.covariance)
            joints = dict(agent.joints)
            away = abs(camera.stamp - agent.stamp) / _NANOSECONDS
        growth = min(self.config.speed * away, self.config.most_growth)
        margin = (
            self._filter.margin + growth + self._filter.sigmas * self._sigma(agent, pose, camera)
        )
        T_camera_base = invert_transform(camera.transform) @ pose.transform
        solids = self._solids(track, joints) if margin <= _MOST_MARGIN else []
        if not solids:
            solids, margin = [_cylinder(agent, margin)], 0.0
        placed = [PlacedSolid(s.solid, T_camera_base @ s.transform, s.name) for s in solids]
        return BodyInScan(robot, placed, margin, away == 0.0)

    def _solids(self, track: _Track, joints: dict[str, float]) -> list[PlacedSolid]:
        """Solids in the frame of the base; none where they are not known."""
        if track.robot is None:
            return []
        try:
            return track.robot.solids_in(track.robot.base_frame, joints)
        except RobotModelError:
            return []

    def _sigma(self, agent: Agent, pose: PoseRecord, camera: PoseRecord) -> float:
        """Bound of the standard deviation of where a body is for the camera [m]."""
        distance = float(np.linalg.norm(pose.transform[:3, 3] - camera.transform[:3, 3]))
        theirs = self.config.unknown_sigma**2
        if pose.covariance is not None:
            arm = np.linalg.norm(agent.T_map_camera[:3, 3] - agent.T_map_base[:3, 3])
            theirs = _largest(pose.covariance, agent.radius + float(arm))
        own = 0.0 if camera.covariance is None else _largest(camera.covariance, distance)
        return float(np.sqrt(theirs + own))


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


def _largest(covariance: FloatArray, lever: float) -> float:
    """Largest variance of a point at a lever [m] from a pose's origin, from above [m^2]."""
    position = np.linalg.eigvalsh(covariance[:3, :3])[-1]
    rotation = np.linalg.eigvalsh(covariance[3:, 3:])[-1]
    # Whatever the two have to do with each other, the deviations add at the most.
    return float((np.sqrt(max(position, 0.0)) + lever * np.sqrt(max(rotation, 0.0))) ** 2)


def _cylinder(agent: Agent, growth: float) -> PlacedSolid:
    """The cylinder about a robot's body, grown, in the frame of its base."""
    height = max(agent.top - agent.bottom, 0.01) + 2.0 * growth
    middle = make_transform(np.eye(3), (0.0, 0.0, 0.5 * (agent.top + agent.bottom)))
    return PlacedSolid(Cylinder(agent.radius + max(growth, 0.01), height), middle, "robot")
