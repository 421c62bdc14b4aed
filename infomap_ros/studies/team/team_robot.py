"""The software of one robot of a simulated team: what dies and starts again with its computer.

What can be set of the exploration of a team.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.errors import PoseUnavailableError, TeammatesBusyError
from infomap_ros.exploration.loop import Ending, EndReason, Exploration
from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.records.run_log import RunLogFile
from infomap_ros.exploration.robot import Choice, FailedView, KnownPlace, RobotState, planar_pose
from infomap_ros.exploration.rules import Control, Request
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.team.keep_clear import PAUSE, Awareness, KeepsClear
from infomap_ros.exploration.team.team_planner import TeamPlanner
from infomap_ros.exploration.team.teammate_places import TeamBodies
from infomap_ros.exploration.team.teamwork import ANNOUNCE_PERIOD, Presence, Teamwork
from infomap_ros.exploration.view_planner import Surrounding, ViewPlanner
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.replay.map_files import MAP_FILE
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, localization_error
from infomap_ros.simulation.exploring.simulated_robot import Observer, SimulatedRobot
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.member import TeamMember
from infomap_ros.team.update import message_bytes, version_at


@dataclass(frozen=True)
class TeamTaskConfig:
    """A team and what may happen to it.

    Raises:
        ConfigError: a value is out of its range.
    """

    robots: int = parameter(2, "Number of robots.", low=1, high=16)
    coverage: float = parameter(
        0.9, "The exploration ends when a robot's map has this share of the true surface.", low=0.0
    )
    loss: float = parameter(0.2, "Share of the packets that are lost.", low=0.0, high=0.95)
    rate: float = parameter(10.0, "Of each robot's radio.", unit="Mbit/s", low=0.01, high=1000.0)
    killed_at: float = parameter(
        0.0,
        "Coverage at which the software of the last robot is ended without warning, to be started "
        "again after `down`; 0 for never.",
        low=0.0,
        high=1.0,
    )
    down: float = parameter(20.0, "Time until it is started again.", unit="s", low=0.0, high=1e4)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class TeamExplorationOptions(ExplorationOptions):
    """Everything that can be set of the exploration of a team."""

    team: TeamTaskConfig = field(default_factory=TeamTaskConfig)
    sharing: TeamConfig = field(
        default_factory=lambda: TeamConfig(bandwidth=0.6, message_size=1400, digest_period=0.2)
    )


MISSION_FILE, LOG_FILE = "mission.json", "exploration.jsonl"
LOCALIZATION_FILE = "localization.infomap"
_BUSY = 1.0  # [s] until a robot that had nothing to do asks again
_ANNOUNCING = 0.4  # [s] after a view in which it is announced before the next one is chosen


@dataclass(frozen=True)
class RobotEquipment:
    """What a robot starts with, each time.

    Attributes:
        number: from 0 on; its id in the team.
        options: of its exploration.
        task: what is to be mapped.
        model: of the robot.
        folder: for its files.
        on_view: called after each view, with the robot.
        observer: of what it measures.
    """

    number: int
    options: TeamExplorationOptions
    task: TaskConfig
    model: RobotModel
    folder: Path
    on_view: Callable[[TeamRobot], None]
    observer: Observer


class TeamRobot:
    """A robot that explores with others; it goes on from its files where there are any.

    Args:
        equipment: what it starts with.
        simulator: its hardware.
        session: number of this start.

    Attributes:
        map: what it saw itself.
        member: its part of the team, with the shared map.
        mission: account so far.
        sent: bytes that it sent, without those of packets.
    """

    def __init__(self, equipment: RobotEquipment, simulator: Simulator, session: int) -> None:
        self.equipment, self._simulator = equipment, simulator
        equipment.folder.mkdir(parents=True, exist_ok=True)
        options = equipment.options
        goes_on = (equipment.folder / MISSION_FILE).exists()
        self.mission = Mission.load(equipment.folder / MISSION_FILE) if goes_on else Mission()
        self.map = self._own_map()
        version = version_at(simulator.stamp)
        config = self.map.config
        self.member = TeamMember(equipment.number, session, version, config, options.sharing)
        self.sent, self._digests_sent = 0, -np.inf
        self._bodies = TeamBodies(body=options.robot.body)
        self._robot = SimulatedRobot(
            simulator, equipment.model, self.map, options.robot, equipment.observer, self._bodies
        )
        self._link = self._robot.link
        if (located := equipment.folder / LOCALIZATION_FILE).exists():
            self._link.resume(located)
        planning = dataclasses.replace(
            options.planner, seed=options.planner.seed + 1000 * equipment.number
        )
        rig, error = self._link.rig, localization_error(self._robot, options)
        planner = ViewPlanner(equipment.model, rig, equipment.task, planning, error)
        self._teamwork = Teamwork(equipment.number, session, version)
        self._planner = TeamPlanner(
            planner, self._teamwork, self._announce, self.let_pass, lambda: simulator.time
        )
        self._spoken: list[tuple[str, Any, int]] = []
        self._announced, self._knows_its_place = -np.inf, False
        self._control = Control()
        log = RunLogFile(equipment.folder / LOG_FILE, goes_on, clock=lambda: simulator.time)
        log.write(
            "start", task=dataclasses.asdict(equipment.task), robot=f"robot {equipment.number}"
        )
        self._exploration = Exploration(
            KeepsClear(self._robot, self._awareness()),
            self,
            equipment.task,
            log,
            self._control,
            self.mission,
            on_step=lambda _: self.mission.save(equipment.folder / MISSION_FILE),
            clock=lambda: simulator.time,
        )

    def explore(self) -> Ending:
        """Explore to the end; first exchange who is where, after a restart what is known."""
        try:
            self._robot.begin()
        except PoseUnavailableError as error:
            return self._exploration.end(Ending(EndReason.FAILED, str(error)))
        self._knows_its_place = True
        recovery = self.equipment.options.sharing.recovery if self.mission.views else 0.0
        self.let_pass(recovery + _ANNOUNCING)
        return self._exploration.run()

    def stop(self) -> None:
        """Let the exploration end soon."""
        self._control.ask(Request.STOP)

    @property
    def known_voxels(self) -> int:
        """Size of the shared map."""
        return self.member.replica.voxel_map.known_voxels

    @property
    def may_go_on(self) -> bool:
        """Whether the budget of views is not spent."""
        return self.mission.views < self.equipment.task.max_views

    def _awareness(self) -> Awareness:
        simulator, model = self._simulator, self.equipment.model
        return Awareness(
            lambda: planar_pose(self._robot.state().T_map_base),
            lambda: self._robot.state().joints,
            lambda joints: model.solids_in(model.base_frame, joints),
            lambda: self._teamwork.present(simulator.time),
            lambda: self.let_pass(PAUSE),
            lambda state, reason: self._exploration.say(state, reason),
        )

    # As the planner of the exploration

    def choose(self, state: RobotState) -> Choice:
        """Keep and send what was seen, then choose the next view in the map of all.

        Raises:
            TeammatesBusyError: the exploration is asked to stop while it waits for others.
        """
        self.map.save(self.equipment.folder / MAP_FILE)
        self._link.save(self.equipment.folder / LOCALIZATION_FILE)
        self.let_pass(_ANNOUNCING)
        self.equipment.on_view(self)
        around = Surrounding.of(self.mission)
        while True:
            try:
                shared = self.member.replica.voxel_map
                return self._planner.choose(shared, self._robot.state(), around)
            except TeammatesBusyError:
                if self._control.interrupted():
                    raise
                self.let_pass(_BUSY)

    def route_to(self, state: RobotState, place: KnownPlace) -> Choice:
        """The route to where the robot has stood."""
        return self._planner.route_to(self.member.replica.voxel_map, state, place)

    def plan_arm(self, state: RobotState, T_map_camera: FloatArray) -> Choice:
        """A motion of the arm alone to a view, from where the base has come to stand."""
        return self._planner.plan_arm(self.member.replica.voxel_map, state, T_map_camera)

    def route_problem(self, state: RobotState) -> str:
        """Why what is left of the route planned last is blocked; empty where it is free."""
        return self._planner.planner.motion.route_problem(self.member.replica.voxel_map, state)

    def failed(self, view: FailedView) -> None:
        """Note that a view could not be reached."""
        self._planner.failed(view)

    # As a member of the team

    def speak(self) -> list[tuple[str, Any, int]]:
        """Messages to send now: kind, content, size [bytes]."""
        now = self._simulator.time
        if self._knows_its_place and now - self._announced >= ANNOUNCE_PERIOD - 1e-6:
            self._announce()
        spoken = [("update", rows) for rows in self.member.updates(self.map, now)]
        if now - self._digests_sent >= self.equipment.options.sharing.digest_period - 1e-6:
            self._digests_sent = now
            spoken += [("digest", rows) for rows in self.member.digests(now)]
            spoken += [("request", rows) for rows in self.member.requests(now)]
        messages = self._spoken + [(kind, rows, message_bytes(rows)) for kind, rows in spoken]
        self._spoken = []
        self.sent += sum(size for _, _, size in messages)
        return messages

    def receive(self, kind: str, content: Any) -> None:
        """A message of another robot has come.

        Raises:
            InfomapError: it cannot be used.
        """
        member = self.member
        handlers: dict[str, Callable[[Any, float], object]] = {
            "update": member.receive_update,
            "digest": member.receive_digest,
            "request": member.receive_request,
            "agent": self._receive_agent,
        }
        handlers[kind](content, self._simulator.time)

    def _receive_agent(self, text: str, now: float) -> None:
        """A teammate has reported where it is and where it is heading."""
        agent = self._teamwork.receive(text, now)
        if agent is not None:
            if not self._bodies.is_described(agent.robot):
                self._bodies.describe(agent.robot, self.equipment.model)
            self._bodies.receive(agent)
            self._link.forget_teammates()

    def _announce(self) -> None:
        """Report with the next messages where this robot is and where it is heading."""
        self._announced = self._simulator.time
        presence = Presence(
            self._simulator.stamp,
            self._robot.state(),
            self.equipment.model,
            self._link.rig.left,
            self.equipment.options.planner.max_range,
        )
        text = self._teamwork.announcement(presence).text
        self._spoken.append(("agent", text, len(text)))

    def let_pass(self, seconds: float) -> None:
        """Let others speak, and receive from them [s]."""
        self._link.let_pass(seconds)

    def _own_map(self) -> VoxelMap:
        options, path = self.equipment.options, self.equipment.folder / MAP_FILE
        config = dataclasses.replace(options.map, max_range=options.planner.max_range)
        own = VoxelMap(config)
        if path.exists():
            own = VoxelMap.from_state(config, VoxelMap.load(path).state())
        own.track_changes(True)
        return own
