"""Teammates in view: where no fiducials are chosen, and by their tags, how their maps lie.

Where a teammate was when the image was taken it reports on team/agents, a little later: until then
a sighting waits. When enough sightings agree, and the two maps are not the same or have not one
origin, one robot moves its map and takes the origin of the other: of two without a target the one
with the larger origin, which begins with the id of the robot that began the map. A robot whose map
is that of a target never moves it, and the other one is asked to.
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
from infomap_ros.exploration.team.teammate_places import TeammatePlaces
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
from infomap_ros.nodes.locating.localization_status import LOOKING, SEEN
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.nodes.team.map_moves import advertise_alignment, alignment_message, describe_move
from infomap_ros.nodes.team.team_topics import AGENTS, TeamIdentityConfig, listen_to_agents
from infomap_ros.team.agent_board import AgentBoard
from infomap_ros.team.update import are_one_frame

_WAITING = 20  # sightings
_PERIOD = 0.5  # shortest time between two looks for teammates [s]
_SIGHTINGS = 4  # of a teammate that must agree before a map is moved


@dataclass
class _Teammate:
    """One teammate: what sightings of it say, and how it is asked to move its map."""

    alignment: TeamAlignment
    moves: Publisher | None = None
    waiting: deque[tuple[int, Alignment, Alignment]] = field(
        default_factory=lambda: deque(maxlen=_WAITING)
    )


class TeammateSight:
    """Knows where teammates are, and looks for their tags in views.

    Used by the worker thread, which is also given what is received.

    Args:
        node: has the configurations of team, tags and places, and speaks.
        worker: in whose thread views are looked at.
        move: moves the own map, ``T_new_old`` with its covariance, to a frame that is named.
        stays: whether the own map is that of a target.

    Attributes:
        origin: names the frame of the own map, as in `PoseUncertainty`.
    """

    origin = 0

    def __init__(
        self,
        node: MonitoredNode,
        worker: Worker,
        move: Callable[[PoseRecord, int], object],
        *,
        stays: bool,
    ) -> None:
        self._node, self._worker, self._move, self._stays = node, worker, move, stays
        tags, who = node.config(TeamTagsConfig), node.config(TeamIdentityConfig)
        self._robot = who.robot_id
        self._key = who.read_key()
        self._board = AgentBoard(who.robot_id, None, who.team, self._key)
        self._places = TeammatePlaces()
        self._frame = node.config(RobotTrackerConfig).map_frame
        carried = tags.carried(but=self._robot)
        self._finder = RobotTagFinder(carried) if carried else None
        self._mates: dict[int, _Teammate] = {}
        self._publishers: dict[str, Publisher] = {}
        self._types, self._looked, self._is_in_view = RclpyMessageTypes(), -(2**62), False
        if self._finder is not None or who.robot_id > 0:
            listen_to_agents(node, self._frame, self._receive)

    def bodies(self, stamp: int) -> Sequence[PlacedSolid]:
        """Cylinders in the map in which the bodies of the others were at a time [ns]."""
        remembered = self._board.remembered(time.monotonic())
        self._places.keep([agent.robot for agent in remembered])
        return self._places.about(stamp, self.origin)

    @property
    def search(self) -> str:
        """Whether teammates are looked for, as of `LocalizationState`."""
        agents = self._places.agents.values()
        joined = any(agent.origin and agent.origin == self.origin for agent in agents)
        if self._finder is None or self._stays or joined:
            return ""
        return SEEN if self._is_in_view else LOOKING

    def other_origin(self) -> int:
        """The only other frame in which teammates report; 0 where there is none, or more."""
        others = {agent.origin for agent in self._places.agents.values()} - {0, self.origin}
        return others.pop() if len(others) == 1 else 0

    def look(self, view: RangeView, result: LocalizedCamera) -> None:
        """Look for teammates in a view.

        Args:
            view: the view.
            result: where the camera was.
        """
        since = 1e-9 * (view.stamp - self._looked)
        is_known = result.T_map_camera is not None and result.covariance is not None
        if self._finder is None or not is_known or 0.0 <= since < _PERIOD:
            return
        self._looked = view.stamp
        camera = Alignment(result.T_map_camera, result.covariance)  # type: ignore[arg-type]
        sightings, refused = self._finder.find(view, np.eye(4))
        self._is_in_view = bool(sightings)
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
        process = partial(self._process, text, time.monotonic())
        self._worker.submit_always(partial(self._node.guard, AGENTS, process))

    def _process(self, text: str, now: float) -> None:
        agent = self._board.receive(text, now)
        if agent is None:
            return
        if (before := self._places.agents.get(agent.robot)) and before.origin != agent.origin:
            self._mates.pop(agent.robot, None)  # what was seen before is of another map
        self._places.receive(agent)
        if self._finder is None:
            return
        if agent.description:
            self._mate(agent.robot).moves = self._publisher(agent.description.rpartition("/")[0])
        self._resolve(agent.robot)

    def _mate(self, robot: int) -> _Teammate:
        if robot not in self._mates:
            self._mates[robot] = _Teammate(TeamAlignment(_SIGHTINGS))
        return self._mates[robot]

    def _resolve(self, robot: int) -> None:
        """Use the sightings for which it is known where the teammate was."""
        mate = self._mate(robot)
        waiting, mate.waiting = mate.waiting, deque(maxlen=_WAITING)
        for stamp, camera, other in waiting:
            try:
                base = self._places.reported_at(robot, stamp).pose
            except PoseUnavailableError as error:
                if error.may_arrive:
                    mate.waiting.append((stamp, camera, other))
                continue
            if base.covariance is None:
                continue
            there = Alignment(base.transform, base.covariance)
            theirs = self._places.agents[robot].origin
            alignment = align_by_sighting(camera, other, there).inverse()
            found = mate.alignment.add(alignment, are_one_frame(theirs, self.origin))
            if mate.alignment.problem:
                self._node.drop("alignment", f"robot {robot}: {mate.alignment.problem}")
            if found is not None:
                self._align(robot, stamp, found)
                return

    def _align(self, robot: int, stamp: int, T_theirs_mine: Alignment) -> None:
        """The maps are not the same: move the own one, or ask the teammate to move its."""
        mate = self._mates[robot]
        mate.alignment.clear()
        mate.waiting.clear()
        theirs = self._places.agents[robot].origin
        if not self._stays and (theirs, robot) < (self.origin, self._robot):
            own = PoseRecord(stamp, self._frame, T_theirs_mine.T_a_b, T_theirs_mine.covariance)
            self._move(own, theirs)
            return
        back = T_theirs_mine.inverse()
        if mate.moves is None:
            self._node.drop("alignment", f"robot {robot} does not say how its topics are called")
            return
        record = PoseRecord(stamp, self._frame, back.T_a_b, back.covariance)
        mate.moves.publish(alignment_message(self._types, record, robot, self._key))
        self._node.get_logger().info(f"asked robot {robot} to move {describe_move(back.T_a_b)}")

    def _publisher(self, namespace: str) -> Publisher:
        """By which the robot in a namespace is asked to move its map."""
        if namespace not in self._publishers:
            publisher = advertise_alignment(self._node, namespace, self._key)
            self._publishers[namespace] = publisher
        return self._publishers[namespace]
