"""The simulated robot finds out where it is as a real one does: images, odometry and joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import PlacedSolid, StereoRig, invert_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.localization.filter.motion_prior import KinematicMotion, MotionPrior, RobotPosture
from infomap_ros.localization.localizer import Localisation, Localizer
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.saved_localisation import SavedLocalisation
from infomap_ros.localization.target.config import TargetConfig, make_detector
from infomap_ros.localization.target.tag_detector import TagTargetConfig
from infomap_ros.mapping import VoxelMap
from infomap_ros.messages.keyframes import KeyframePoses
from infomap_ros.motion import RobotModel
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.simulation.exploring.pose_source import CameraPose, PosedScan
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.simulation.worlds.target_board import WORLD_BOARD
from infomap_ros.stereo import StereoConfig, StereoRangeSensor, StereoRectifier

_PAUSE = 0.1  # [s] between two pairs from one place


def _board_of_the_worlds() -> TargetConfig:
    return TargetConfig(kind="tags", tags=TagTargetConfig(board=WORLD_BOARD))


def _rover_on_rough_ground() -> DeadReckoningConfig:
    return DeadReckoningConfig(
        position_per_metre=0.08,
        position_per_radian=0.05,
        rotation_per_metre=0.02,
        rotation_per_radian=0.02,
        kinematics_position_sigma=0.003,
        kinematics_rotation_sigma=0.004,
    )


def _with_kinematics() -> LocalizerConfig:
    """Odometry and joints tell the way well enough to look at the sky for a while."""
    return LocalizerConfig(max_coasting=60.0)


@dataclass(frozen=True)
class SelfLocalisationConfig:
    """When the simulated robot takes pairs to localise by, and how.

    Raises:
        ConfigError: a value is out of its range.
    """

    first_pairs: int = parameter(
        8, "Pairs that are taken of the target before the first move.", low=1, high=1000
    )
    pair_distance: float = parameter(
        0.2, "On its way, it takes a pair after this way of the camera.", unit="m", low=0.001
    )
    pair_angle: float = parameter(
        0.25, "Likewise after this turn of the camera.", unit="rad", low=0.01, high=3.0
    )
    more_pairs: int = parameter(
        3,
        "So many pairs more are taken at a view whose pose no known fiducials tell: new ones are "
        "chosen there, and tie what follows to the pose that odometry and joints tell.",
        low=0,
        high=100,
    )
    target: TargetConfig = field(default_factory=_board_of_the_worlds)
    motion: DeadReckoningConfig = field(default_factory=_rover_on_rough_ground)
    localizer: LocalizerConfig = field(default_factory=_with_kinematics)

    def __post_init__(self) -> None:
        check_config(self)


class SelfLocalisation:
    """Runs a `Localizer` on what the simulated robot sees and feels.

    Where no view tells the pose, it is the last one that was told moved on by odometry and joints,
    with a covariance that grows accordingly.

    Args:
        simulator: gives raw pairs, joint states and odometry.
        robot: its model, with the camera frame.
        stereo: how pairs are measured.
        config: when pairs are taken, and how they are used.
        others: bodies of teammates at a time [ns], placed in the map: they carry no fiducials.

    Implements `infomap_ros.simulation.exploring.pose_source.PoseSource`.

    Attributes:
        rig: the rectified stereo pair.
        localizer: with its fiducials and keyframes.
        last: what the last pair told.
    """

    def __init__(
        self,
        simulator: Simulator,
        robot: RobotModel,
        stereo: StereoConfig,
        config: SelfLocalisationConfig | None = None,
        others: Callable[[int], Sequence[PlacedSolid]] = lambda _: (),
    ) -> None:
        self.config = config or SelfLocalisationConfig()
        self._others = others
        self._simulator, self._robot = simulator, robot
        self._rectifier = StereoRectifier(*simulator.calibrations)
        self.rig: StereoRig = self._rectifier.rig
        self._sensor = StereoRangeSensor(self.rig, stereo)
        detector = make_detector(self.config.target)
        self.localizer = Localizer(self.rig.left, self.config.localizer, detector)
        self._kinematics = KinematicMotion(self.config.motion)
        self._posture: RobotPosture | None = None
        self._is_resumed = False
        self._known: tuple[CameraPose, RobotPosture] | None = None
        self.last: Localisation | None = None

    def see(self, voxel_map: VoxelMap | None = None) -> StereoView:
        """Take a pair and localise by it; `last` says what came of it.

        Args:
            voxel_map: for the certainty of new fiducials.

        Raises:
            SimulationError: this machine cannot draw images.
        """
        pair, joints = self._simulator.capture(), self._joints()
        posture = self._measured_posture(joints)
        view = StereoView(pair.stamp, *self._rectifier.rectify(pair.left, pair.right), self._sensor)
        body = self._robot.solids_in(self._robot.camera_frame, joints)
        prior, others = self._prior(posture), self._others(pair.stamp)
        self.last = self.localizer.locate(view, prior, voxel_map, body=body, others=others)
        self._posture = posture
        if self.last.state == "tracking" or self._known is None:
            self._note_pose(self.last, posture)
        return view

    def _note_pose(self, told: Localisation, posture: RobotPosture) -> None:
        """What a view told, or just after a restart, odometry and joints since what was kept."""
        if told.T_map_camera is not None and told.covariance is not None:
            pose = CameraPose(told.T_map_camera, told.covariance, told.uncertainty)
            self._known = pose, posture

    def initialise(self) -> None:
        """Look at the target several times; after `resume`, find out where the robot is now.

        Raises:
            PoseUnavailableError: it is not in view, or nothing that is known is.
        """
        for _ in range(self.config.first_pairs):
            if self._is_resumed and self._known is not None:
                break
            self._simulator.step(_PAUSE)
            self.see()
        if self._known is None:
            raise PoseUnavailableError(f"the first pose is not known: {self._problem()}")

    def pose(self) -> CameraPose:
        """Where the camera is now.

        Raises:
            PoseUnavailableError: it was never known.
        """
        if self._known is None:
            raise PoseUnavailableError("the first pose is not known: no pair was taken")
        pose, posture = self._known
        return pose.moved(self._kinematics.since(posture, self._measured_posture()))

    def take_scan(self, voxel_map: VoxelMap) -> PosedScan:
        """Take a stereo pair now, and localise by it; take another one where it tells too little.

        Raises:
            PoseUnavailableError: none tells from where it was taken.
            SimulationError: this machine cannot draw images.
        """
        view = self.see(voxel_map)
        for _ in range(self.config.more_pairs):
            if self.last is None or self.last.state != "coasting" or self.last.contradicted:
                break
            self._simulator.step(_PAUSE)
            view = self.see(voxel_map)
        if self._known is None or self.last is None or self.last.state != "tracking":
            raise PoseUnavailableError(f"where the camera is is not known: {self._problem()}")
        return PosedScan(view.stamp, view.cloud(), self._known[0])

    def watch(self, voxel_map: VoxelMap) -> str:
        """Take a pair where one is due; why localisation is lost, where it was not before.

        A robot that is lost may go on by odometry and joints: standing still finds nothing again.
        """
        if not self._has_moved():
            return ""
        was_lost = self._is_lost()
        self.see(voxel_map)
        return f"localisation: {self._problem()}" if self._is_lost() and not was_lost else ""

    def correct(self, builder: MapBuilder) -> None:
        """Let the scans of a map follow the keyframes, as they are known now."""
        kept = self.localizer.keyframes()
        poses = kept.stamps, kept.transforms
        builder.add_keyframes(KeyframePoses(self._simulator.stamp, "map", *poses))
        builder.correct()

    def save(self, path: Path) -> None:
        """Keep map and pose of the localisation in a file; see `PoseSource`."""
        SavedLocalisation(self.localizer.state(), self._posture).save(path)

    def resume(self, path: Path) -> None:
        """Go on from what was kept; odometry and joints tell the way since. See `PoseSource`."""
        saved = SavedLocalisation.load(path)
        saved.resume(self.localizer)
        self._posture, self._is_resumed = saved.posture, True

    def _is_lost(self) -> bool:
        return self.last is not None and self.last.state in ("lost", "searching")

    def _problem(self) -> str:
        return "" if self.last is None else f"{self.last.state}, {self.last.reason}"

    def _has_moved(self) -> bool:
        """Whether the camera is so far from where the last pair was taken that one is due."""
        if self._posture is None:
            return True
        before, now = self._posture.T_odom_camera, self._measured_posture().T_odom_camera
        motion = invert_transform(before) @ now
        angle = float(Rotation.from_matrix(motion[:3, :3]).magnitude())
        way = float(np.linalg.norm(motion[:3, 3]))
        return way > self.config.pair_distance or angle > self.config.pair_angle

    def _prior(self, posture: RobotPosture) -> MotionPrior | None:
        """Expected motion since the last pair.

        The kinematics' errors at the two ends of a way that no view tells count once, not at every
        pair that was taken in vain on it: those in between cancel.
        """
        if self._posture is None:
            return None
        is_known = self.last is None or self.last.state == "tracking"
        kinematics = self._kinematics if is_known else self._kinematics.odometry_alone
        return kinematics.between(self._posture, posture)

    def _joints(self) -> dict[str, float]:
        record = self._simulator.joint_state()
        return dict(zip(record.names, map(float, record.positions), strict=True))

    def _measured_posture(self, joints: dict[str, float] | None = None) -> RobotPosture:
        angles = self._joints() if joints is None else joints
        T_base_camera = self._robot.forward_kinematics(angles, self._robot.camera_frame)
        return RobotPosture(self._simulator.odometry().transform, T_base_camera)
