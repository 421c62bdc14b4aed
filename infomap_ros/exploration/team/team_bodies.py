"""Teammates' bodies in a scan, so that no robot maps another.

A robot that stood in view before it was heard, or while it was forgotten, was a part of the scene
until then: when it is heard again, its body is taken out of what was fused (`take_arrivals`).

A teammate's solids, or the upright cylinder about all of them where these are not known, are grown
by how far it may have moved since it told its place, by the body filter's margin, and by the
standard deviation of where the teammate is for this camera.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import PoseUnavailableError, RobotModelError
from infomap_ros.exploration.team.teammate_places import (
    BodyInScan,
    TeammatePlaces,
    TeammatePlacesConfig,
    cylinder_about,
    largest_variance,
)
from infomap_ros.geometry import PlacedSolid, PoseRecord, invert_transform
from infomap_ros.geometry.config import setting
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.team.agents import Agent

_MOST_MARGIN = 1.0  # [m]; solids that would have to grow by more are replaced by the cylinder
_OVER_GROUND = 0.03  # [m]; what is no higher than this over a body's lowest point is its ground
_SURE_MARGIN = 0.15  # [m]; of a body that is taken out of what was fused
_NANOSECONDS = 1e9


@dataclass(frozen=True)
class TeamBodiesConfig(TeammatePlacesConfig):
    """How teammates' bodies are found in scans.

    Raises:
        ConfigError: a value is out of its range.
    """

    wait: float = setting(
        0.5,
        "How long a scan waits until it is known where teammates were at its stamp, in time of the "
        "data.",
        unit="s",
        low=0.0,
        high=10.0,
    )


class TeamBodies(TeammatePlaces):
    """Knows also what teammates' bodies are, for the scans of one robot.

    Args:
        config: how they are found.
        body: how much bodies are grown.
    """

    def __init__(
        self, config: TeamBodiesConfig | None = None, body: BodyFilterConfig | None = None
    ) -> None:
        settings = config or TeamBodiesConfig()
        super().__init__(settings, body)
        self._wait = settings.wait * _NANOSECONDS
        self._models: dict[int, RobotModel] = {}
        self._before: dict[int, Agent] = {}
        self._arrived: set[int] = set()

    def describe(self, robot: int, model: RobotModel) -> None:
        """What a teammate's body is: with its base frame, as it tells its pose."""
        self._models[robot] = model

    def is_described(self, robot: int) -> bool:
        """Whether a teammate's solids are known."""
        return robot in self._models

    def keep(self, robots: Collection[int]) -> list[Agent]:
        """Forget all robots but these; returns what the forgotten ones told last."""
        gone = super().keep(robots)
        self._before |= {agent.robot: agent for agent in gone}
        self._models = {robot: self._models[robot] for robot in self._models if robot in robots}
        self._arrived &= set(robots)
        return gone

    def take_arrivals(self) -> list[BodyInScan]:
        """Bodies of teammates that are heard for the first time, or again, in the map's frame.

        Each is told once, when its solids are known and it is known where it is. Where it stood
        when it was heard last counts, too.
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
            robots: teammates that are heard.

        Raises:
            PoseUnavailableError: it may still be told where one was at that time.
        """
        if newest - stamp >= self._wait:
            return
        for robot in self.agents.keys() & set(robots):
            try:
                self.told_at(robot, stamp)
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
        """A teammate's body in the map as it told it, the frame of the map in place of a camera."""
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
