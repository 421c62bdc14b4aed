"""A team of rovers explores one simulated world: views and meters until most of it is mapped.

All in one process, without ROS: the world, the robots' software and the channel between them. The
messages are those of the wire, a share of their packets is lost, and one robot's software may be
ended midway, without a chance to tidy up, and started again from its files.
"""

from __future__ import annotations

import dataclasses
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.errors import ExplorationError, UpdateRefusedError
from infomap_ros.exploration.loop import Ending, EndReason
from infomap_ros.exploration.mission import Mission
from infomap_ros.geometry.resources import find_share
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.exploring.exploration_run import map_frame, planned_robot, task_in
from infomap_ros.simulation.exploring.truth import PoseAudit, TrueSurface
from infomap_ros.simulation.team_world import TeamWorld
from infomap_ros.simulation.turns import SwitchedOff
from infomap_ros.studies.team.team_network import Channel, Radio
from infomap_ros.studies.team.team_robot import RobotEquipment, TeamExplorationOptions, TeamRobot

_TICK = 0.1  # [s] of robots that have nothing to do
_MORE = 1.03  # by this factor the map must have grown for a robot that had ended to go on
_AGREEING = 120.0  # [s] in which the maps must become the same at the end


@dataclass(frozen=True)
class Look:
    """State of a team after a view of one of its robots.

    Attributes:
        robot: which one.
        seconds: simulated [s].
        views: of all robots so far.
        distance: of all robots so far [m].
        coverage: share of the true surface in the map of this robot.
    """

    robot: int
    seconds: float
    views: int
    distance: float
    coverage: float


class TeamExploration:
    """Builds the world and its robots, and lets them explore.

    Args:
        options: of everything.
        out: folder for the robots' files.

    Attributes:
        world: with the simulated robots.
        T_world_map: where the frame of all maps truly is, shape (4, 4): at the target, if they
            localize themselves by it.
        audits: how wrong the poses of the robots' scans were.
        robots: their software, as it runs now.
        looks: what the views brought.
        kills: how often software was ended.

    Raises:
        InfomapError: world or robot cannot be made.
    """

    def __init__(self, options: TeamExplorationOptions, out: Path) -> None:
        self.options, world = options, options.world
        scene = world.make()
        description = read_description(find_share(world.description))
        settings = dataclasses.replace(options.simulator, seed=world.seed)
        count = options.team.robots
        self.world = TeamWorld(scene, description, settings, count, self._exchange)
        self.T_world_map = map_frame(scene, options.robot)
        self._surface = TrueSurface(scene, self.T_world_map, options.planner.max_range)
        self.audits = [PoseAudit(robot, self.T_world_map) for robot in self.world.simulators]
        self._rng = np.random.default_rng(world.seed)
        self._channel = Channel(count, Radio(options.team.rate * 1e6, options.team.loss), self._rng)
        model = planned_robot(self.world.simulators[0])
        task = task_in(scene, options.task, self.T_world_map)
        task = dataclasses.replace(task, known_fraction=1.0)
        self._outfits = [
            RobotEquipment(n, own, task, model, out / str(n), self._on_view, audit)
            for n, (own, audit) in enumerate(zip(self._own_options(), self.audits, strict=True))
        ]
        self._missions: dict[int, Mission] = {}
        self.robots: list[TeamRobot | None] = [self._start(n) for n in range(count)]
        self._endings: dict[int, Ending] = {}
        self.looks: list[Look] = []
        self.kills, self._is_over = 0, False

    def _own_options(self) -> list[TeamExplorationOptions]:
        """What each robot is given: no more space about it is declared clear than is."""
        planner = self.options.planner
        clear = [min(planner.start_clearance, start.clearance) for start in self.world.starts]
        own = [dataclasses.replace(planner, start_clearance=radius) for radius in clear]
        return [dataclasses.replace(self.options, planner=each) for each in own]

    def run(self) -> dict[str, Any]:
        """Explore to the end, let the maps agree, and say what came of it.

        Raises:
            ExplorationError: no robot has taken a view; says why.
        """
        begin = time.process_time()
        names, simulators = self.world.names, self.world.simulators
        self.world.turns.run({name: partial(self._live, n) for n, name in enumerate(names)})
        if not self.looks:
            raise ExplorationError("; ".join(ending.detail for ending in self._endings.values()))
        agreed, last = self._agree(), self.looks[-1]
        return {
            "world": self.options.world.title,
            "robots": len(self.robots),
            "views": last.views,
            "views_per_robot": round(last.views / len(self.robots), 2),
            "distance": round(last.distance, 2),
            "distance_per_robot": round(last.distance / len(self.robots), 2),
            "simulated_seconds": round(max(look.seconds for look in self.looks), 1),
            "touched": [list(map(dataclasses.astuple, s.contact_events)) for s in simulators],
            "kills": self.kills,
            "same_hash": agreed is not None,
            "agreed_after": agreed,
            "sent_bytes": [robot.sent for robot in self.robots if robot],
            "ends": [self._endings[n].reason.value for n in sorted(self._endings)],
            "details": [self._endings[n].detail for n in sorted(self._endings)],
            **self._errors(),
            "processor_seconds": round(time.process_time() - begin, 1),
        }

    def _errors(self) -> dict[str, Any]:
        """How the robots' poses and their common map compare with the truth."""
        shared = next(robot.member.replica.voxel_map for robot in self.robots if robot)
        poses = [pose for audit in self.audits for pose in audit.poses]
        truth = self._surface.compare(shared, poses, self.world.contacts)
        errors = [audit.figures() for audit in self.audits]
        names = ("pose_error_rms", "pose_error_end")
        return {name: [each.get(name) for each in errors] for name in names} | truth.figures()

    def _start(self, number: int) -> TeamRobot:
        session = int(self._rng.integers(1, 2**32))
        robot = TeamRobot(self._outfits[number], self.world.simulators[number], session)
        self._missions[number] = robot.mission
        return robot

    def _live(self, number: int) -> None:
        """The life of a robot, in its thread: its software may end and start again."""
        try:
            while not self._is_over:
                try:
                    self._explore(number)
                except SwitchedOff:
                    self._break_down(number)
        finally:
            self._is_over |= number not in self._endings
            self.world.simulators[number].close()  # in the thread that drew

    def _explore(self, number: int) -> None:
        """Explore, and again when others have found more, until nobody finds anything."""
        robot = self.robots[number]
        while robot is not None and not self._is_over:
            self._endings[number] = robot.explore()
            self._wait(number, robot)

    def _wait(self, number: int, robot: TeamRobot) -> None:
        """Receive and answer until others have found more, or nobody explores any more."""
        known = robot.known_voxels
        while not self._is_over:
            self._is_over = len(self._endings) == len(self.robots)
            robot.let_pass(_TICK)
            if robot.may_go_on and robot.known_voxels > _MORE * known:
                del self._endings[number]
                return

    def _break_down(self, number: int) -> None:
        """The software has ended without warning; start it again after a while.

        Raises:
            SwitchedOff: because another robot's thread has failed.
        """
        if self.world.turns.failed:
            raise
        simulator = self.world.simulators[number]
        self.robots[number] = None
        self.kills += 1
        simulator.stop()
        for _ in range(round(self.options.team.down / _TICK)):
            simulator.step(_TICK)
        self.robots[number] = self._start(number)
        if self._is_over:
            self._endings[number] = Ending(EndReason.STOPPED, "the others have mapped enough")

    def _on_view(self, robot: TeamRobot) -> None:
        """Measure what a view brought; see whether it is enough, or time for a mishap."""
        task, number = self.options.team, robot.equipment.number
        coverage = self._surface.coverage(robot.member.replica.voxel_map)
        views = sum(mission.views for mission in self._missions.values())
        distance = sum(mission.distance for mission in self._missions.values())
        now = self.world.simulators[number].time
        self.looks.append(Look(number, now, views, distance, coverage))
        if coverage >= task.coverage:
            self._is_over = True
            for each in self.robots:
                if each is not None:
                    each.stop()
        elif task.killed_at and not self.kills and coverage >= task.killed_at:
            self.world.turns.switch_off(self.world.names[-1])

    def _exchange(self, number: int) -> None:
        """After each step of a robot: it speaks, and what has come is received."""
        robot, now = self.robots[number], self.world.simulators[number].time
        if robot is not None:
            for kind, content, size in robot.speak():
                self._channel.send(number, kind, content, size, now)
        for receiver, kind, content in self._channel.deliver(now):
            listener = self.robots[receiver]
            if listener is not None:
                with suppress(UpdateRefusedError):  # asks for what it was before a restart
                    listener.receive(kind, content)

    def _agree(self) -> float | None:
        """Time until all maps are the same [s]; None where they do not become it."""
        for tick in range(round(_AGREEING / _TICK)):
            hashes = {robot.member.replica.hash() for robot in self.robots if robot}
            if len(hashes) == 1:
                return round(tick * _TICK, 2)
            for simulator in self.world.simulators:
                simulator.step(_TICK)
        return None
