"""Teammates' bodies in a scan, so that no robot maps another.

A robot that stood in view before it was heard, or while it was forgotten, was a part of the scene
until then: when it is heard again, its body is taken out of what was fused (`take_arrivals`).

Where a teammate was at a scan's stamp is interpolated between what it told before and after. Where
that is not known, it is within its speed times the time of where it was. Its solids, or the upright
cylinder about all of them where these are not known, are grown by that, by the body filter's
margin, and by the standard deviation of where the teammate is for this camera.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import PoseUnavailableError, RobotModelError
from infomap_ros.exploration.team.bodies_in_scan import (
    BodyInScan,
    cylinder_about,
    largest_variance,
    on_bodies,
)
from infomap_ros.exploration.team.team_bodies_config import TeamBodiesConfig, TeammatePlacesConfig
from infomap_ros.geometry import (
    JointStateRecord,
    PlacedSolid,
    PoseBuffer,
    PoseBufferConfig,
    PoseRecord,
    invert_transform,
)
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.motion import RobotModel
from infomap_ros.team.agents import Agent

_MOST_MARGIN = 1.0  # [m]; solids that would have to grow by more are replaced by the cylinder
_OVER_GROUND = 0.03  # [m]; what is no higher than this over a body's lowest point is its ground
_MOST_AROUND = 0.3  # [m] about a teammate where no fiducials are chosen: others are needed
_RECENT = 10  # messages whose postures count for the cylinder about a teammate
_SURE_MARGIN = 0.15  # [m]; of a body that is taken out of what was fused
_NANOSECONDS = 1e9


class _Track:
    """Where one teammate was, and what it is."""

    def __init__(self, config: TeammatePlacesConfig) -> None:
        self.poses = PoseBuffer(PoseBufferConfig(max_gap=config.max_gap, capacity=100))
        self.joints = JointBuffer(JointBufferConfig(max_gap=config.max_gap, capacity=100))
        self.robot: RobotModel | None = None
        self.recent: deque[Agent] = deque(maxlen=_RECENT)
        self.has_arrived = False

    def add(self, agent: Agent) -> None:
        self.recent.append(agent)
        covariance = agent.covariance
        self.poses.add(PoseRecord(agent.stamp, "map", agent.T_map_base, covariance))
        names = tuple(agent.joints)
        positions = np.array([agent.joints[name] for name in names], dtype=np.float64)
        self.joints.add(JointStateRecord(agent.stamp, "", names, positions))

    @property
    def agent(self) -> Agent | None:
        """What it told last; None where only its body is known."""
        return self.recent[-1] if self.recent else None

    def about(self, growth: float) -> PlacedSolid:
        """The cylinder about its body in all postures of late, grown, in the frame of its base."""
        largest = replace(
            self.recent[-1],
            radius=max(agent.radius for agent in self.recent),
            bottom=min(agent.bottom for agent in self.recent),
            top=max(agent.top for agent in self.recent),
        )
        return cylinder_about(largest, growth)

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
        self._before: dict[int, Agent] = {}

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
            agent = self._tracks.pop(robot).agent
            if agent is not None:
                self._before[robot] = agent

    def take_arrivals(self) -> list[BodyInScan]:
        """Bodies of teammates that are heard for the first time, or again, in the map's frame.

        Each is told once, when its solids are known and it is known where it is. Where it stood
        when it was heard last counts, too.
        """
        bodies = []
        for robot, track in self._tracks.items():
            agent = track.agent
            if track.has_arrived or track.robot is None or agent is None:
                continue
            if (body := self._in_map(track, agent)).margin <= _SURE_MARGIN:
                track.has_arrived = True
                bodies.append(body)
                if (before := self._before.pop(robot, None)) is not None:
                    bodies.append(self._in_map(track, before))
        return bodies

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

    def about(self, stamp: int) -> list[PlacedSolid]:
        """An upright cylinder about each teammate, in which any of it was at a time.

        A teammate that is silent or lost takes no more room than `_MOST_AROUND` about its body.

        Args:
            stamp: [ns].

        Returns:
            Placed in the map, grown as the solids are for a scan, but for the error of its pose.
        """
        cylinders = []
        for _, track in sorted(self._tracks.items()):
            if (agent := track.agent) is not None:
                pose, _, away = self._where(track, agent, stamp)
                sigma = float(np.sqrt(self._their_variance(pose, agent.radius)))
                margin = self._filter.margin + self._growth(away) + self._filter.sigmas * sigma
                about = track.about(min(margin, _MOST_AROUND))
                placed = pose.transform @ about.transform
                cylinders.append(PlacedSolid(about.solid, placed, about.name))
        return cylinders

    def mask(
        self, points: ArrayLike, covariances: ArrayLike | None, camera: PoseRecord
    ) -> NDArray[np.bool_]:
        """Mark the points of a scan that may lie on a teammate; see `on_bodies`."""
        return on_bodies(points, covariances, self.bodies_in(camera), self._filter)

    def _placed(self, robot: int, track: _Track, camera: PoseRecord) -> BodyInScan:
        agent = track.agent
        assert agent is not None
        pose, joints, away = self._where(track, agent, camera.stamp)
        growth = self._growth(away)
        margin = (
            self._filter.margin + growth + self._filter.sigmas * self._sigma(agent, pose, camera)
        )
        T_camera_base = invert_transform(camera.transform) @ pose.transform
        solids = self._solids(track, joints) if margin <= _MOST_MARGIN else []
        if not solids:
            solids, margin = [cylinder_about(agent, margin)], 0.0
        placed = [PlacedSolid(s.solid, T_camera_base @ s.transform, s.name) for s in solids]
        return BodyInScan(robot, placed, margin, away == 0.0)

    def _where(
        self, track: _Track, agent: Agent, stamp: int
    ) -> tuple[PoseRecord, dict[str, float], float]:
        """Pose and joints at a time, and how far in time from there they were told [s]."""
        try:
            return *track.at(stamp), 0.0
        except PoseUnavailableError:
            pose = PoseRecord(agent.stamp, "map", agent.T_map_base, agent.covariance)
            away = abs(stamp - agent.stamp) / _NANOSECONDS
            return pose, dict(agent.joints), away

    def _growth(self, away: float) -> float:
        """How far a teammate may have moved in a time [s], in metres."""
        return min(self.config.speed * away, self.config.most_growth)

    def _in_map(self, track: _Track, agent: Agent) -> BodyInScan:
        """A teammate's body in the map as it told it, the frame of the map in place of a camera."""
        pose = PoseRecord(agent.stamp, "map", agent.T_map_base, agent.covariance)
        margin = self._filter.margin + self._filter.sigmas * self._sigma(
            agent, pose, PoseRecord(agent.stamp, "map", np.eye(4))
        )
        placed = [
            PlacedSolid(s.solid, agent.T_map_base @ s.transform, s.name)
            for s in self._solids(track, dict(agent.joints))
        ]
        up, lowest = agent.T_map_base[:3, 2], np.array([0.0, 0.0, agent.bottom, 1.0])
        level = float(up @ (agent.T_map_base @ lowest)[:3]) + _OVER_GROUND
        return BodyInScan(agent.robot, placed, margin, True, np.array([*up, level]))

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
        arm = np.linalg.norm(agent.T_map_camera[:3, 3] - agent.T_map_base[:3, 3])
        theirs = self._their_variance(pose, agent.radius + float(arm))
        own = 0.0 if camera.covariance is None else largest_variance(camera.covariance, distance)
        return float(np.sqrt(theirs + own))

    def _their_variance(self, pose: PoseRecord, lever: float) -> float:
        """Largest variance of a point of a body at a lever [m] from its base [m^2]."""
        if pose.covariance is None:
            return self.config.unknown_sigma**2
        return largest_variance(pose.covariance, lever)
