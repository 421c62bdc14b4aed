"""A simulated robot with its software in one process: what the nodes do, without messages.

The simulator is the source of records; the pipeline makes of them what the nodes make of messages,
and the exploration commands and waits as it does through topics. Time passes while it waits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.exploration.commanded_robot import CommandedRobot, CommandedRobotConfig
from infomap_ros.exploration.robot import Interrupted, RobotState
from infomap_ros.exploration.team.teammate_places import BodyInScan, TeamBodies
from infomap_ros.geometry import (
    JointStateRecord,
    OdometryRecord,
    PlacedSolid,
    PoseRecord,
    Record,
    StereoRig,
    rig_from_calibrations,
)
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.filter.config import Fiducials
from infomap_ros.localization.filter.motion_prior import KinematicMotion
from infomap_ros.localization.localizer_config import CalibrationConfig, LocalizerConfig
from infomap_ros.localization.saved_localization import SavedLocalization
from infomap_ros.localization.target.config import TargetConfig, make_detector
from infomap_ros.localization.target.tag_detector import TagTargetConfig
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.messages import RosbagsMessageTypes, decode, encode, message_type_of
from infomap_ros.messages.commands import decode_arm_trajectory, decode_base_path
from infomap_ros.messages.fiducials import decode_fiducials, encode_fiducials
from infomap_ros.messages.motions import encode_arm_trajectory, encode_base_path
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.route import ArmPath
from infomap_ros.pipeline.camera_localizer import CameraLocalizer, CameraLocalizerConfig
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.pipeline.perception import (
    FramedView,
    ImageSources,
    Perception,
    StereoViewEstimator,
)
from infomap_ros.pipeline.pipeline import (
    Fused,
    Fusion,
    Localization,
    Located,
    Pipeline,
    as_sent,
)
from infomap_ros.pipeline.range_estimator import RangeMeasurement, StereoRangeEstimator
from infomap_ros.pipeline.robot_body import RobotBody
from infomap_ros.pipeline.robot_motion import RobotMotion
from infomap_ros.pipeline.scan_synchronizer import LocatedPoses, Scan, ScanSynchronizer
from infomap_ros.pipeline.tracked_robot import TrackedRobot
from infomap_ros.pipeline.view_synchronizer import ViewSynchronizer
from infomap_ros.simulation.robot_commands import RobotCommands
from infomap_ros.simulation.sensor_schedule import (
    SIDES,
    TICK,
    Due,
    Measured,
    SensorSchedule,
    SensorScheduleConfig,
)
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.simulation.worlds.target_board import WORLD_BOARD
from infomap_ros.stereo import StereoConfig

IMAGE_RATE = 2.0
"""Pairs per simulated second, so that the arm turns the cameras by little between two [Hz]."""

_MAP_FRAME = "map"
_CORRECTED_PER_VIEW = 8  # scans; with 2 Hz those of 5 minutes follow a correction within 40 s
_UPRIGHT = 0.85  # least cosine of the tilt of a robot that has not tipped over
_START_PATIENCE = 15.0  # [s] until the first scan is fused
_SENT = JointStateRecord | OdometryRecord | PoseRecord
_SOURCES = ImageSources(
    tuple(f"{side}/image_raw" for side in SIDES), tuple(f"{side}/camera_info" for side in SIDES)
)
_TYPES = RosbagsMessageTypes()


def _board_of_the_worlds() -> TargetConfig:
    return TargetConfig(kind="tags", tags=TagTargetConfig(board=WORLD_BOARD))


SKIDDING = DeadReckoningConfig(
    position_per_meter=0.08,
    position_per_radian=0.05,
    rotation_per_meter=0.02,
    rotation_per_radian=0.02,
    kinematics_position_sigma=0.003,
    kinematics_rotation_sigma=0.004,
)
"""Odometry of wheels that skid where the base turns, on slopes.

The wheels of the simulator are 2.5 % too small to odometry: as independent steps that is 0.08 m
after one meter, for the 10 m over which it adds up, and 16 mm in a turn by 1.2 rad, which it was
off on mars, are 0.05 m after one radian for ten such turns. With two driven wheels a turn was less
than a millimeter off: there the defaults are right.
"""


def _exactly_calibrated() -> LocalizerConfig:
    """The simulated camera is exactly as its calibration says."""
    return LocalizerConfig(calibration=CalibrationConfig(0.0, 0.0, 0.0))


@dataclass(frozen=True)
class SimulatedLocalizationConfig:
    """How the simulated robot locates its camera: by the board of its world, and what it sees."""

    target: TargetConfig = field(default_factory=_board_of_the_worlds)
    motion: DeadReckoningConfig = field(default_factory=DeadReckoningConfig)
    localizer: LocalizerConfig = field(default_factory=_exactly_calibrated)


@dataclass(frozen=True)
class SimulatedRobotConfig:
    """The software of a simulated robot.

    Raises:
        ConfigError: a value is out of its range.
    """

    pose_source: str = parameter(
        "localization",
        "Where the robot has its pose from: localization, by its own images, odometry and joints; "
        "or the simulator, the truth with a little noise.",
        choices=("localization", "simulator"),
    )
    image_rate: float = parameter(
        IMAGE_RATE, "Stereo pairs per simulated second.", unit="Hz", low=0.01, high=60.0
    )
    images_while_moving: bool = parameter(True, "Take pairs while the robot moves.")
    motion: CommandedRobotConfig = field(default_factory=CommandedRobotConfig)
    localization: SimulatedLocalizationConfig = field(default_factory=SimulatedLocalizationConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    body: BodyFilterConfig = field(default_factory=BodyFilterConfig)

    def __post_init__(self) -> None:
        check_config(self)

    @property
    def localizes(self) -> bool:
        """Whether it locates its camera itself."""
        return self.pose_source == "localization"


class Observer(Protocol):
    """Watches what a robot measures, for evaluation."""

    def image_taken(self, stamp: int) -> None:
        """A pair was taken just now, at `stamp` [ns]."""

    def scan_fused(self, scan: Scan[RangeMeasurement]) -> None:
        """A scan is in the map."""


class SimulatedRobot(CommandedRobot):
    """Implements `infomap_ros.exploration.robot.Robot` on a `Simulator`.

    Args:
        simulator: moves and draws.
        robot: the robot's model, with its camera frame.
        voxel_map: receives what is seen.
        config: of its software.
        observer: is told of images and scans.
        teammates: whose bodies are cut from scans and carry no fiducials.

    Attributes:
        link: to the simulator.
    """

    def __init__(
        self,
        simulator: Simulator,
        robot: RobotModel,
        voxel_map: VoxelMap,
        config: SimulatedRobotConfig | None = None,
        observer: Observer | None = None,
        teammates: TeamBodies | None = None,
    ) -> None:
        config = config or SimulatedRobotConfig()
        self.link = SimulatedLink(simulator, robot, voxel_map, config, observer, teammates)
        super().__init__(self.link, config.motion)

    def begin(self) -> None:
        """Let time pass until the robot knows where it is, and sees.

        Raises:
            PoseUnavailableError: it does not find out; says why.
        """
        link = self.link

        def has_begun() -> bool:
            return link.known_state() is not None and self.sees

        if not link.wait_until(has_begun, _START_PATIENCE, lambda: False):
            raise PoseUnavailableError(f"the first pose is not known: {link.problem}")


class SimulatedLink:
    """Implements `infomap_ros.exploration.commanded_robot.RobotLink`; see `SimulatedRobot`.

    Attributes:
        model: of the robot.
        rig: the rectified stereo pair.
        fused_scans: see `RobotLink`.
    """

    def __init__(
        self,
        simulator: Simulator,
        robot: RobotModel,
        voxel_map: VoxelMap,
        config: SimulatedRobotConfig,
        observer: Observer | None,
        teammates: TeamBodies | None,
    ) -> None:
        self._simulator, self._observer, self._teammates = simulator, observer, teammates
        self.model = robot
        motion = config.localization.motion
        skids = simulator.skids and motion == DeadReckoningConfig()
        self.motion_noise = SKIDDING if skids else motion
        self.rig: StereoRig = rig_from_calibrations(*simulator.calibrations)
        sensors = SensorScheduleConfig(
            image_rate=config.image_rate,
            images_while_moving=config.images_while_moving,
            publish_camera_pose=not config.localizes,
        )
        self._sensors = SensorSchedule(simulator, sensors, _MAP_FRAME)
        self._commands = RobotCommands(simulator, _MAP_FRAME)
        self._tracked = TrackedRobot()
        self._tracked.describe(robot, robot.camera_frame)
        self._localizer: CameraLocalizer | None = None
        estimator: StereoRangeEstimator | StereoViewEstimator
        if config.localizes:
            estimator = StereoViewEstimator(config.stereo, rectify=True, is_dense=True)
        else:
            estimator = StereoRangeEstimator(config.stereo, rectify=True)
        self._perception = Perception(_SOURCES, estimator)
        localization = self._localization(robot, config) if config.localizes else None
        store = ScanStoreConfig() if config.localizes else None
        self._builder = MapBuilder(voxel_map, store, config.body)
        body = RobotBody(robot)
        scans: ScanSynchronizer[RangeMeasurement] = ScanSynchronizer(
            LocatedPoses(_MAP_FRAME),
            body,
            None if teammates is None else _TeammatesInScans(teammates),
        )
        fusion = Fusion(scans, body, self._builder, _MAP_FRAME, _CORRECTED_PER_VIEW)
        self._pipeline = Pipeline(localization, fusion)
        self._fiducials: Fiducials | None = None
        self.fused_scans, self._state = 0, "no image was looked at"

    def _localization(self, robot: RobotModel, config: SimulatedRobotConfig) -> Localization:
        own = config.localization
        motion = RobotMotion(robot.camera_frame, robot)
        views: ViewSynchronizer[FramedView] = ViewSynchronizer(motion, is_required=True)
        detector, kinematics = make_detector(own.target), KinematicMotion(self.motion_noise)
        self._localizer = CameraLocalizer(
            CameraLocalizerConfig(own.localizer, kinematics, detector)
        )
        return Localization(views, motion, self._localizer, others=self._others)

    def _others(self, stamp: int) -> Sequence[PlacedSolid]:
        return () if self._teammates is None else self._teammates.about(stamp)

    @property
    def problem(self) -> str:
        """What localization says of the last view, where it does not know where it was taken."""
        is_upright = self._simulator.true_pose()[2, 2] > _UPRIGHT
        return self._state + ("" if is_upright else "; the robot has tipped over")

    def known_state(self, in_odometry: bool = False) -> RobotState | None:
        """See `RobotLink`."""
        return self._tracked.known_state(in_odometry)

    def joint_positions(self) -> Mapping[str, float]:
        """See `RobotLink`."""
        return self._tracked.joint_positions()

    def joint_velocities(self) -> Mapping[str, float]:
        """See `RobotLink`."""
        return self._tracked.joint_velocities()

    def base_speed(self) -> float:
        """See `RobotLink`."""
        return self._tracked.base_speed

    def send_base_path(self, poses: FloatArray, in_odometry: bool) -> str:
        """See `RobotLink`."""
        frame = self._tracked.odom_frame if in_odometry else _MAP_FRAME
        message = encode_base_path(_TYPES, self._simulator.stamp, frame, poses)
        self._commands.follow_base_path(decode_base_path(message))
        return "path"

    def send_arm_path(self, path: ArmPath) -> str:
        """See `RobotLink`."""
        message = encode_arm_trajectory(_TYPES, 0, path)
        self._commands.follow_arm_trajectory(decode_arm_trajectory(message))
        return "trajectory"

    @property
    def reports_results(self) -> bool:
        """False: what a simulated robot has done is seen, as of one that is driven by topics."""
        return False

    def result(self, motion: str) -> str | None:
        """None."""
        return None

    def wait_until(
        self, condition: Callable[[], bool], timeout: float, interrupted: Interrupted
    ) -> bool:
        """See `RobotLink`; the time is that of the simulator."""
        end = self._simulator.time + timeout
        while not condition():
            if interrupted() or self._simulator.time > end:
                return False
            self.advance()
        return True

    def let_pass(self, seconds: float) -> None:
        """Let time pass [s]; the robot goes on with what it was sent, and sees."""
        end = self._simulator.time + seconds - 0.5 * TICK
        while self._simulator.time < end:
            self.advance()

    def advance(self) -> None:
        """Let time pass until something is measured, and use it."""
        due = Due(state=False, image=False)
        while not due.state:
            self._commands.note_place()
            self._simulator.step(TICK)
            due = self._sensors.due()
        measured = self._sensors.state()
        if due.image:
            if self._observer is not None:
                self._observer.image_taken(self._simulator.stamp)
            measured += self._sensors.camera_infos() + self._sensors.pair()
        self._commands.note_place()
        self._use(measured)

    def fiducials(self) -> Fiducials | None:
        """The scene's fiducials, as they were known at the last view that was located."""
        return self._fiducials

    def forget_teammates(self) -> None:
        """Take teammates that are new or back out of what was fused before they were known."""
        for body in [] if self._teammates is None else self._teammates.take_arrivals():
            self._builder.forget_body(body)

    def save(self, path: Path) -> None:
        """Keep in a file what localization needs to go on when this software was ended.

        Raises:
            MapFileError: the file cannot be written.
        """
        if self._localizer is not None and (saved := self._localizer.saved()) is not None:
            saved.save(path)

    def resume(self, path: Path) -> None:
        """Go on from what was kept, in the same map; before time passes.

        Raises:
            MapFileError: the file cannot be used.
        """
        if self._localizer is not None:
            self._localizer.resume(SavedLocalization.load(path))

    def finish(self) -> None:
        """Do what waits, and let the map follow all that localization has found out."""
        for done in self._pipeline.finish():
            self._note(done)

    def _use(self, measured: Measured) -> None:
        """What becomes of records, in the order in which they come."""
        for topic, record in measured:
            received = as_received(record)
            self._track(received)
            for seen in self._perception.add(topic, received):
                for done in self._pipeline.process(seen):
                    self._note(done)

    def _note(self, done: Located | Fused) -> None:
        if isinstance(done, Fused):
            self.fused_scans += 1
            if self._observer is not None:
                self._observer.scan_fused(done.scan)
            return
        result = done.result
        self._state = ", ".join(filter(None, (result.state, result.reason)))
        if result.T_map_camera is None or self._localizer is None:
            return
        transform, covariance = as_sent(result.T_map_camera), result.covariance
        self._track(PoseRecord(result.stamp, _MAP_FRAME, transform, covariance))
        if (known := self._localizer.fiducials()) is not None:
            message = encode_fiducials(_TYPES, result.stamp, _MAP_FRAME, known)
            self._fiducials = decode_fiducials(message)[2]

    def _track(self, record: Record) -> None:
        if isinstance(record, _SENT):
            self._tracked.add(record)
        if isinstance(record, PoseRecord):
            self._commands.locate(record)


class _TeammatesInScans:
    """Teammates of whom all are heard; implements `scan_synchronizer.Teammates`."""

    def __init__(self, bodies: TeamBodies) -> None:
        self._bodies = bodies

    def check_known_at(self, stamp: int, newest: int) -> None:
        self._bodies.check_known_at(stamp, newest, self._bodies.agents)

    def bodies_in(self, camera: PoseRecord) -> Sequence[BodyInScan]:
        return self._bodies.bodies_in(camera)


def as_received(record: Record) -> Record:
    """A record as it is when a message has carried it: rotations are rounded by quaternions."""
    if not isinstance(record, _SENT):
        return record
    return decode(message_type_of(record), encode(_TYPES, record))[0]
