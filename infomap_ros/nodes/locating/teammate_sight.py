"""Teammates in view: where no fiducials are chosen, and by their tags, how their maps lie.

Where a teammate was when the image was taken it tells on team/agents, a little later: until then a
sighting waits. When enough sightings agree that the two maps are not the same, one robot moves its
map: of two without a target the one with the larger id. A robot whose map is that of a target never
moves it, and the other one is told.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from rclpy.publisher import Publisher

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.exploration.team.teammate_places import TeammatePlaces, TeammatePlacesConfig
from infomap_ros.geometry import PlacedSolid, PoseRecord
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.localization.target.team_alignment import (
    Alignment,
    RobotTagFinder,
    TeamAlignment,
    TeamTagsConfig,
    align_by_sighting,
)
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.nodes.team.map_moves import advertise_alignment, alignment_message, describe_move
from infomap_ros.nodes.team.team_topics import AGENTS, TeamIdentityConfig, listen_to_agents
from infomap_ros.team.agent_board import AgentBoard
from infomap_ros.team.agents import AgentBoardConfig

_WAITING = 20  # sightings


@dataclass
class _Teammate:
    """One teammate: what sightings of it tell, and how it is told."""

    alignment: TeamAlignment
    tell: Publisher | None = None
    waiting: deque[tuple[int, Alignment, Alignment]] = field(
        default_factory=lambda: deque(maxlen=_WAITING)
    )


class TeammateSight:
    """Knows where teammates are, and looks for their tags in views.

    Used by the worker thread, which is also given what is heard.

    Args:
        node: has the configurations of team, tags and places, and speaks.
        worker: in whose thread views are looked at.
        move: moves the own map, ``T_new_old`` with its covariance.
        stays: whether the own map is that of a target.
    """

    def __init__(
        self,
        node: MonitoredNode,
        worker: Worker,
        move: Callable[[PoseRecord], object],
        *,
        stays: bool,
    ) -> None:
        self._node, self._worker, self._move, self._stays = node, worker, move, stays
        self._config, who = node.config(TeamTagsConfig), node.config(TeamIdentityConfig)
        self._robot = who.robot_id
        self._key = who.read_key()
        memory = node.config(AgentBoardConfig)
        self._board = AgentBoard(who.robot_id, None, memory, who.team, self._key)
        self._places = TeammatePlaces(node.config(TeammatePlacesConfig))
        self._frame = node.config(RobotTrackerConfig).map_frame
        carried = self._config.carried(but=self._robot)
        self._finder = RobotTagFinder(carried) if carried else None
        self._mates: dict[int, _Teammate] = {}
        self._publishers: dict[str, Publisher] = {}
        self._types, self._looked = RclpyMessageTypes(), -(2**62)
        if self._finder is not None or who.robot_id > 0:
            listen_to_agents(node, self._frame, self._receive)

    def bodies(self, stamp: int) -> Sequence[PlacedSolid]:
        """Cylinders in the map in which the bodies of the others were at a time [ns]."""
        remembered = self._board.remembered(time.monotonic())
        self._places.keep([agent.robot for agent in remembered])
        return self._places.about(stamp)

    def look(self, view: RangeView, result: LocalizedCamera) -> None:
        """Look for teammates in a view.

        Args:
            view: the view.
            result: where the camera was.
        """
        since = 1e-9 * (view.stamp - self._looked)
        is_known = result.T_map_camera is not None and result.covariance is not None
        if self._finder is None or not is_known or 0.0 <= since < self._config.period:
            return
        self._looked = view.stamp
        camera = Alignment(result.T_map_camera, result.covariance)  # type: ignore[arg-type]
        sightings, refused = self._finder.find(view, np.eye(4))
        for robot, why in refused.items():
            self._node.drop("teammate not measured", f"robot {robot}: {why.reason} {why.detail}")
        for one in sightings:
            other = Alignment(one.T_base_other, one.covariance)
            self._mate(int(one.robot)).waiting.append((view.stamp, camera, other))
            self._node.health.note(f"robot {one.robot} seen at", str(view.stamp))
            self._resolve(int(one.robot))

    def forget(self) -> None:
        """Forget what was seen so far, as when the own map was moved."""
        for mate in self._mates.values():
            mate.alignment.clear()
            mate.waiting.clear()

    def _receive(self, text: str) -> None:
        hear = partial(self._hear, text, time.monotonic())
        self._worker.submit_always(partial(self._node.guard, AGENTS, hear))

    def _hear(self, text: str, now: float) -> None:
        agent = self._board.hear(text, now)
        if agent is None:
            return
        self._places.hear(agent)
        if self._finder is None:
            return
        if agent.description:
            self._mate(agent.robot).tell = self._publisher(agent.description.rpartition("/")[0])
        self._resolve(agent.robot)

    def _mate(self, robot: int) -> _Teammate:
        if robot not in self._mates:
            self._mates[robot] = _Teammate(TeamAlignment(self._config.sightings))
        return self._mates[robot]

    def _resolve(self, robot: int) -> None:
        """Use the sightings for which it is known where the teammate was."""
        mate = self._mate(robot)
        waiting, mate.waiting = mate.waiting, deque(maxlen=_WAITING)
        for stamp, camera, other in waiting:
            try:
                base = self._places.told_at(robot, stamp).pose
            except PoseUnavailableError as error:
                if error.may_arrive:
                    mate.waiting.append((stamp, camera, other))
                continue
            if base.covariance is None:
                continue
            there = Alignment(base.transform, base.covariance)
            found = mate.alignment.add(align_by_sighting(camera, other, there).inverse())
            if mate.alignment.problem:
                self._node.drop("alignment", f"robot {robot}: {mate.alignment.problem}")
            if found is not None:
                self._align(robot, stamp, found)
                return

    def _align(self, robot: int, stamp: int, T_theirs_mine: Alignment) -> None:
        """The maps are not the same: move the own one, or tell the teammate to move its."""
        mate = self._mates[robot]
        mate.alignment.clear()
        mate.waiting.clear()
        if not self._stays and robot < self._robot:
            told = PoseRecord(stamp, self._frame, T_theirs_mine.T_a_b, T_theirs_mine.covariance)
            self._move(told)
            return
        back = T_theirs_mine.inverse()
        if mate.tell is None:
            self._node.drop("alignment", f"robot {robot} does not say how its topics are called")
            return
        record = PoseRecord(stamp, self._frame, back.T_a_b, back.covariance)
        mate.tell.publish(alignment_message(self._types, record, robot, self._key))
        self._node.get_logger().info(f"told robot {robot} to move {describe_move(back.T_a_b)}")

    def _publisher(self, namespace: str) -> Publisher:
        """By which the robot in a namespace is told to move its map."""
        if namespace not in self._publishers:
            publisher = advertise_alignment(self._node, namespace, self._key)
            self._publishers[namespace] = publisher
        return self._publishers[namespace]
