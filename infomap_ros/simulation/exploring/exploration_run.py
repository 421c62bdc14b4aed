"""An exploration in the simulator, in one process and without ROS."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.errors import ConfigError, InvalidInputError, PoseUnavailableError
from infomap_ros.exploration.fiducial_error import FiducialLocalizationError
from infomap_ros.exploration.loop import Ending, EndReason, Exploration
from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.records.recorded_run import read_run
from infomap_ros.exploration.records.run_figures import (
    commonest,
    hindrance_figures,
    prediction_figures,
)
from infomap_ros.exploration.records.run_log import RunLogFile
from infomap_ros.exploration.reports.report import write_report
from infomap_ros.exploration.robot import Choice, FailedView, KnownPlace, RobotState
from infomap_ros.exploration.rules import Control
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_planner import Surrounding, ViewPlanner, ViewPlannerConfig
from infomap_ros.geometry import invert_transform, transform_points
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.resources import find_share
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.prediction.error_prediction import ErrorPredictionConfig
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.export import write_ply
from infomap_ros.motion.base.path_following import PathFollowingConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.replay.map_files import MAP_FILE, PLY_FILE, SUMMARY_FILE
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.exploring.simulated_robot import SimulatedRobot, SimulatedRobotConfig
from infomap_ros.simulation.exploring.truth import PoseAudit, RunTruth, TrueSurface
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.file_world import WORLD_FILES, is_world_file
from infomap_ros.simulation.worlds.scenes import WORLDS, make_world
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate, next_version
from infomap_ros.team.wire import decode_update, encode_update

_ROBOT, _SESSION = 1, 1


class PlanningMap:
    """A replica of a robot's map. Updates are rounded, so it is not quite the map itself.

    Args:
        voxel_map: of the robot; its changes are tracked from now on.
    """

    def __init__(self, voxel_map: VoxelMap) -> None:
        self._own, self._version = voxel_map, 1
        voxel_map.track_changes(True)
        size, limit = voxel_map.config.voxel_size, voxel_map.config.memory_limit
        self._replica = MapReplica(VoxelMapConfig(voxel_size=size, memory_limit=limit))
        self._message_size = TeamConfig().message_size

    def current(self) -> VoxelMap:
        """What is known now; to be read only.

        Raises:
            CapacityError: it does not fit into the memory limit of the map.
        """
        changes = self._own.take_changes()
        if len(changes.indices):
            self._version = next_version(self._version)
            size = self._own.config.voxel_size
            update = MapUpdate.of_changes(changes, size, _ROBOT, self._version, _SESSION)
            for rows in encode_update(update, self._message_size):
                self._replica.accept(decode_update(rows))
        return self._replica.voxel_map


LOG_FILE, REPORT_FILE = "exploration.jsonl", "report.html"


@dataclass(frozen=True)
class WorldConfig:
    """Which world is explored, and by which robot.

    Raises:
        ConfigError: a value is out of its range.
    """

    name: str = parameter(
        "mars", "mars, office or cave; or a mesh, or the .yaml of a floor plan of map_server."
    )
    seed: int = parameter(1, "Seed of the world and of all noise.", low=0)
    size: float = parameter(
        0.0, "Size of the world; 0 for its usual size.", unit="m", low=0.0, high=100.0
    )
    up: str = setting("auto", "Axis of a mesh that is up.", choices=("auto", "y", "z"))
    unit: float = setting(
        0.0, "Meters in one unit of a mesh; 0 to guess.", unit="m", low=0.0, high=1000.0
    )
    start: tuple[float, ...] = setting(
        (), "Place x, y in a file at which the robot starts; empty to look for one.", unit="m"
    )
    description: str = parameter(
        "config/rover.urdf", "Robot description: a path, or one below the package's share folder."
    )

    def __post_init__(self) -> None:
        check_config(self)
        if self.name not in WORLDS and not is_world_file(self.name):
            expected = f"one of {', '.join(WORLDS)}, or a file {', '.join(WORLD_FILES)}"
            raise ConfigError("name", self.name, expected)

    @property
    def title(self) -> str:
        """Name and seed, or that of its file."""
        is_file = is_world_file(self.name)
        return Path(self.name).stem if is_file else f"{self.name} {self.seed}"

    def make(self) -> World:
        """The world, without a robot; raises as `make_world`."""
        given: dict[str, Any] = {"size": self.size} if self.size else {}
        if is_world_file(self.name):
            given |= {"up": self.up, "unit": self.unit, "start": self.start}
        return make_world(self.name, self.seed, **given)


@dataclass(frozen=True)
class ExplorationOptions:
    """Everything that can be set of a simulated exploration."""

    world: WorldConfig = field(default_factory=WorldConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    map: VoxelMapConfig = field(default_factory=VoxelMapConfig)
    planner: ViewPlannerConfig = field(default_factory=ViewPlannerConfig)
    robot: SimulatedRobotConfig = field(default_factory=SimulatedRobotConfig)
    simulator: SimulatorConfig = field(default_factory=SimulatorConfig)
    prediction: ErrorPredictionConfig = field(default_factory=ErrorPredictionConfig)


class _MapPlanner:
    """A `ViewPlanner` with its map: implements `infomap_ros.exploration.robot.Planner`.

    As next_best_view does, it checks the route that it planned last with each scan that is fused.
    """

    def __init__(self, planner: ViewPlanner, voxel_map: VoxelMap, robot: SimulatedRobot) -> None:
        self._planner, self._robot = planner, robot
        self._map, self.mission = PlanningMap(voxel_map), Mission()
        self._checked: tuple[int, str] = (-1, "")

    def choose(self, state: RobotState) -> Choice:
        around = Surrounding.of(self.mission)
        return self._planned(self._planner.choose(self._map.current(), state, around))

    def route_to(self, state: RobotState, place: KnownPlace) -> Choice:
        return self._planned(self._planner.route_to(self._map.current(), state, place))

    def plan_arm(self, state: RobotState, T_map_camera: FloatArray) -> Choice:
        return self._planned(self._planner.plan_arm(self._map.current(), state, T_map_camera))

    def route_problem(self, state: RobotState) -> str:
        fused = self._robot.link.fused_scans
        if self._checked[0] != fused:
            self._checked = fused, self._planner.motion.route_problem(self._map.current(), state)
        return self._checked[1]

    def failed(self, view: FailedView) -> None:
        self._planner.failed(view)

    def _planned(self, choice: Choice) -> Choice:
        self._checked = self._robot.link.fused_scans, ""
        return choice


class ExplorationRun:
    """Builds world, robot, map and planner, explores, and writes what came of it.

    The task's budget of time is that of the simulated world, so that the end does not depend on
    the machine.

    Args:
        options: of everything.
        out: folder for the results.
        on_entry: called with each entry of the run log.

    Attributes:
        map: what has been mapped.
        T_world_map: where the map's frame truly is, shape (4, 4).
        audit: how wrong the poses were.
        simulator: with its ground truth.
        robot: in it, with its software.
        control: for requests while it runs.

    Raises:
        InfomapError: world or robot cannot be made.
        OSError: the folder cannot be written.
    """

    def __init__(
        self,
        options: ExplorationOptions,
        out: Path,
        on_entry: Callable[[Mapping[str, Any]], None] | None = None,
    ) -> None:
        self.options, self._out = options, out
        out.mkdir(parents=True, exist_ok=True)
        seed = options.world.seed
        description = _description(options.world.description)
        settings = dataclasses.replace(options.simulator, seed=seed)
        world = options.world.make()
        self.simulator = Simulator(world, description, settings)
        self.T_world_map = map_frame(world, options.robot)
        task = task_in(world, options.task, self.T_world_map)
        robot = planned_robot(self.simulator)
        self.map = VoxelMap(dataclasses.replace(options.map, max_range=options.planner.max_range))
        self.audit = PoseAudit(self.simulator, self.T_world_map)
        self.robot = SimulatedRobot(self.simulator, robot, self.map, options.robot, self.audit)
        rig, error = self.robot.link.rig, localization_error(self.robot, options)
        planner = ViewPlanner(robot, rig, task, _as_driven(options), error)
        self._planner = _MapPlanner(planner, self.map, self.robot)
        self._log = RunLogFile(
            out / LOG_FILE, on_entry=on_entry, robot_clock=lambda: self.simulator.time
        )
        self.control = Control()
        self._exploration = Exploration(
            self.robot,
            self._planner,
            task,
            self._log,
            self.control,
            self._planner.mission,
            clock=lambda: self.simulator.time,
        )
        self._write_start(task)

    def run(self) -> Ending:
        """Explore to the end."""
        self._begin = time.monotonic()
        try:
            self.robot.begin()
        except PoseUnavailableError as error:
            return self._exploration.end(Ending(EndReason.FAILED, str(error)))
        ending = self._exploration.run()
        self.robot.link.finish()
        return ending

    def write_results(self, ending: Ending) -> dict[str, object]:
        """Write map file, .ply, summary and report; returns the summary.

        Raises:
            OSError: a file cannot be written.
        """
        self.map.save(self._out / MAP_FILE)
        write_ply(self.map, self._out / PLY_FILE)
        run = read_run(self._out / LOG_FILE)
        summary = self.summary(ending) | prediction_figures(run) | hindrance_figures(run)
        text = json.dumps(summary, indent=1) + "\n"
        write_text(self._out / SUMMARY_FILE, text)
        world = self.options.world
        title = f"Exploring {world.title}"
        write_report(
            self._out / REPORT_FILE, self._out / LOG_FILE, self.map, title, figures=summary
        )
        return summary

    def summary(self, ending: Ending) -> dict[str, object]:
        """Figures of the run, flat."""
        mission, progress = self._exploration.mission, self._exploration.progress
        known, precise, sigma = 0.0, 0.0, None
        if progress is not None:
            known, precise = progress.known_fraction, progress.precise_fraction
            sigma = progress.mean_sigma
        return {
            "world": self.options.world.name,
            "seed": self.options.world.seed,
            "end": ending.reason.value,
            "detail": ending.detail,
            "views": mission.views,
            "distance": round(mission.distance, 2),
            "known_fraction": round(known, 4),
            "precise_fraction": round(precise, 4),
            "mean_sigma": sigma,
            "simulated_seconds": round(self.simulator.time, 1),
            "seconds": round(time.monotonic() - self._begin, 1),
            "known_voxels": self.map.known_voxels,
            "surface_voxels": self.map.surface_voxels,
            "memory_bytes": self.map.memory_bytes(),
            "voxel_size": self.map.config.voxel_size,
            "pose_source": self.options.robot.pose_source,
            **self.audit.figures(),
            **self.truth.figures(),
            **self._touched(),
        }

    def _touched(self) -> dict[str, object]:
        """What touched what it should not, and when, where and how deep; nothing where none did."""
        events = self.simulator.contact_events
        if not events:
            return {}
        touched = commonest((f"{event.link} with {event.other}", 1) for event in events)
        return {"touched": touched, "touches": [dataclasses.asdict(each) for each in events]}

    @functools.cached_property
    def truth(self) -> RunTruth:
        """How map, poses and contacts compare with the truth; to be asked for at the end."""
        world, max_range = self.simulator.world, self.options.planner.max_range
        surface = TrueSurface(world, self.T_world_map, max_range)
        return surface.compare(self.map, self.audit.poses, self.simulator.contacts)

    def close(self) -> None:
        """Free what drawing needs."""
        self.simulator.close()

    def _write_start(self, task: TaskConfig) -> None:
        options, camera = self.options, self.robot.link.rig.left
        names = ("width", "height", "fx", "fy", "cx", "cy")
        self._log.write(
            "start",
            task=dataclasses.asdict(task),
            robot=Path(options.world.description).stem,
            world=options.world.title,
            strategy=options.planner.strategy,
            voxel_size=options.map.voxel_size,
            camera={name: getattr(camera, name) for name in names},
            max_range=options.planner.max_range,
        )


def planned_robot(simulator: Simulator) -> RobotModel:
    """The model that plans the motions of a simulated robot, with its camera and arm.

    Args:
        simulator: of the robot.
    """
    setup = simulator.config.robot
    frames = setup.left_camera_frame, setup.base_frame
    robot = RobotModel.from_urdf(simulator.description, *frames, mimics=setup.leaders)
    if set(robot.arm.joint_names) <= set(setup.arm_joints):
        return robot
    moved = tuple(name for name in setup.arm_joints if name in robot.arm.joint_names)
    return RobotModel.from_urdf(
        simulator.description, *frames, arm_joints=moved, mimics=setup.leaders
    ).holding(dict(zip(setup.arm_joints, setup.home, strict=True)))


def _as_driven(options: ExplorationOptions) -> ViewPlannerConfig:
    """The planner's configuration, with the speeds at which the simulator drives.

    Raises:
        ConfigError: the planner was given other ones.
    """
    given, driven = options.planner.reaching.following, options.simulator.following
    if given not in (driven, PathFollowingConfig()):
        expected = "what simulator.following says, which is what drives"
        raise ConfigError("planner.reaching.following", given, expected)
    reaching = dataclasses.replace(options.planner.reaching, following=options.simulator.following)
    return dataclasses.replace(options.planner, reaching=reaching)


def task_in(world: World, task: TaskConfig, T_world_map: FloatArray | None = None) -> TaskConfig:
    """The task with the world's own region, unless another than the default was asked for.

    Args:
        world: with its region.
        task: as asked for, in the map's frame.
        T_world_map: where the map's frame is, shape (4, 4); the world's where not given. The
            region becomes the box about the world's region.
    """
    default = TaskConfig()
    if (task.region_low, task.region_high) != (default.region_low, default.region_high):
        return task
    corners = np.array(list(itertools.product(*world.region.T)))
    if T_world_map is not None:
        corners = transform_points(invert_transform(T_world_map), corners)
    low, high = (tuple(map(float, end)) for end in (corners.min(axis=0), corners.max(axis=0)))
    return dataclasses.replace(task, region_low=low, region_high=high)


def map_frame(world: World, robot: SimulatedRobotConfig) -> FloatArray:
    """Where the frame of a robot's map truly is, shape (4, 4): at the target, if it localizes.

    Raises:
        InvalidInputError: there is no target to localize by.
    """
    if not robot.localizes:
        return np.eye(4)
    if world.T_world_target is None:
        raise InvalidInputError("world", "has no target to localize by")
    T_target_map = invert_transform(robot.localization.target.T_map_target)
    return np.asarray(world.T_world_target @ T_target_map)


def localization_error(
    robot: SimulatedRobot, options: ExplorationOptions
) -> FiducialLocalizationError:
    """What the rating takes for LE; drift, where poses come from the simulator.

    Args:
        robot: that localizes itself, or not.
        options: of its exploration.
    """
    link = robot.link
    return FiducialLocalizationError(
        link.rig, link.fiducials, options.prediction, link.motion_noise
    )


def _description(place: str) -> str:
    """Text of a robot description."""
    path = Path(place)
    return read_description(path if path.is_file() else find_share(place))
