"""The simulated robot as the exploration sees it: commands, waits, looks, and fuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.exploration.planar import planar_pose
from infomap_ros.exploration.robot import Interrupted, Motion, RobotState
from infomap_ros.exploration.team.team_bodies import TeamBodies
from infomap_ros.geometry import PoseRecord, invert_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.correction.correctable_map import CorrectableMap
from infomap_ros.mapping.correction.reintegration import ReintegrationConfig
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.motion import RobotModel
from infomap_ros.motion.route import ArmPath
from infomap_ros.simulation.exploring.pose_source import MeasuredPoses, PosedScan, PoseSource
from infomap_ros.simulation.exploring.self_localisation import (
    SelfLocalisation,
    SelfLocalisationConfig,
)
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.stereo import StereoConfig


@dataclass(frozen=True)
class ExploringRobotConfig:
    """How the simulated robot takes views and carries out motions.

    Raises:
        ConfigError: a value is out of its range.
    """

    scans_per_view: int = parameter(
        2,
        "Stereo pairs that are fused at each view: one look rarely makes a voxel free.",
        low=1,
        high=100,
    )
    scan_period: float = parameter(
        0.2, "Time between two stereo pairs of a view.", unit="s", low=0.0, high=10.0
    )
    tick: float = parameter(
        0.1, "Time that is simulated between two looks at what goes on.", unit="s", low=0.01
    )
    motion_timeout: float = parameter(
        180.0, "A motion that takes longer has failed.", unit="s", low=1.0, high=3600.0
    )
    pose_source: str = parameter(
        "localization",
        "Where the robot has its pose from: localization, by its own images, odometry and joints; "
        "or the simulator, the truth with a little noise.",
        choices=("localization", "simulator"),
    )
    localization: SelfLocalisationConfig = field(default_factory=SelfLocalisationConfig)
    correction: ReintegrationConfig = field(default_factory=ReintegrationConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    body: BodyFilterConfig = field(default_factory=BodyFilterConfig)

    def __post_init__(self) -> None:
        check_config(self)


class SimulatedRobot:
    """Implements `infomap_ros.exploration.robot.Robot` on a `Simulator`.

    Args:
        simulator: moves and draws.
        robot: the robot's model, with its camera frame.
        voxel_map: receives what is seen.
        config: how views are taken.
        on_scan: called with each scan that was fused.
        teammates: whose bodies are cut from scans and carry no fiducials.

    Attributes:
        poses: where it has its pose from.
    """

    def __init__(
        self,
        simulator: Simulator,
        robot: RobotModel,
        voxel_map: VoxelMap,
        config: ExploringRobotConfig | None = None,
        on_scan: Callable[[PosedScan], None] = lambda _: None,
        teammates: TeamBodies | None = None,
    ) -> None:
        self._simulator, self._robot = simulator, robot
        self._config = config = config or ExploringRobotConfig()
        self.poses: PoseSource
        if config.pose_source == "localization":
            others = (lambda _: ()) if teammates is None else teammates.about
            self.poses = SelfLocalisation(
                simulator, robot, config.stereo, config.localization, others
            )
            store = ScanStoreConfig()
        else:
            self.poses = MeasuredPoses(simulator, config.stereo)
            store = ScanStoreConfig(memory=0.0)
        self._map = CorrectableMap(voxel_map, store, config.correction)
        self._on_scan, self._has_begun = on_scan, False
        self._teammates = teammates

    def state(self) -> RobotState:
        """Where it is, as localisation and joint encoders measure it."""
        self._begin()
        pose, joints = self.poses.pose(), self._joints()
        T_base_camera = self._robot.forward_kinematics(joints, self._robot.camera_frame)
        T_map_base = pose.transform @ invert_transform(T_base_camera)
        return RobotState(T_map_base, pose.transform, pose.covariance, joints)

    def look(self, interrupted: Interrupted) -> str:
        """Take stereo pairs from here and fuse them; tells why where its pose is not known."""
        self._begin()
        for _ in range(self._config.scans_per_view):
            if interrupted():
                return "broken off"
            self._simulator.step(self._config.scan_period)
            try:
                scan = self.poses.take_scan(self._map.voxel_map)
            except PoseUnavailableError as error:
                return str(error)
            self._fuse(scan)
        self.poses.correct(self._map)
        return ""

    def forget_teammates(self) -> None:
        """Take teammates that are new or back out of what was fused before they were known."""
        for body in [] if self._teammates is None else self._teammates.take_arrivals():
            grown = replace(self._config.body, margin=body.margin)
            self._map.forget_body(body.solids, grown, body.ground)

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        """Move the arm along a path."""
        self._simulator.follow_arm_trajectory(path.joint_names, path.positions, path.times)
        problem, places = self._finish(interrupted, camera=True)
        return Motion(problem, places)

    def drive(self, poses: FloatArray, interrupted: Interrupted) -> Motion:
        """Drive along base poses (x, y, yaw), shape (K, 3), map frame."""
        self._simulator.follow_base_path(poses, self._T_odom_map())
        problem, places = self._finish(interrupted, camera=False)
        return Motion(problem, places)

    def _begin(self) -> None:
        """Find out where the robot is, the first time it is asked for."""
        if not self._has_begun:
            self.poses.initialise()
            self._has_begun = True

    def _T_odom_map(self) -> FloatArray:
        """Where localisation and odometry together have the map, level, shape (4, 4)."""
        odometry = self._simulator.odometry().transform
        return _level(odometry @ invert_transform(self.state().T_map_base))

    def _finish(self, interrupted: Interrupted, camera: bool) -> tuple[str, list[list[float]]]:
        """Let the simulation run until the robot rests; the problem, and where it came by."""
        simulator, begin = self._simulator, self._simulator.time
        places = [self._place(camera)]
        while simulator.is_moving:
            late = simulator.time - begin > self._config.motion_timeout
            problem = f"not done after {self._config.motion_timeout:g} s" if late else ""
            problem = "broken off" if interrupted() else problem
            simulator.step(self._config.tick)
            problem = problem or self.poses.watch(self._map.voxel_map)
            if problem:
                simulator.stop()
                simulator.step(1.0)
                return problem, places
            if not camera:
                simulator.correct_path(self._T_odom_map())
            place = self._place(camera)
            if np.linalg.norm(np.subtract(place, places[-1])) > 0.02:
                places.append(place)
        return simulator.problem, places

    def _place(self, camera: bool) -> list[float]:
        """Where it believes its camera or base to be, shape (3,) [m, map]."""
        state = self.state()
        pose = state.T_map_camera if camera else state.T_map_base
        return [float(number) for number in pose[:3, 3]]

    def _joints(self) -> dict[str, float]:
        record = self._simulator.joint_state()
        return dict(zip(record.names, map(float, record.positions), strict=True))

    def _fuse(self, scan: PosedScan) -> None:
        """One scan into the map, without the robot's own body and those of its teammates."""
        cloud, pose = scan.cloud, scan.pose
        points = cloud.organised_points
        body = self._robot.solids_in(self._robot.camera_frame, self._joints())
        on_body = body_mask(points, cloud.covariance_triangles, body, self._config.body)
        if self._teammates is not None:
            at_scan = PoseRecord(scan.stamp, "map", pose.transform, pose.covariance)
            on_body |= self._teammates.mask(points, cloud.covariance_triangles, at_scan)
        points = np.where(on_body[..., None], np.float32(np.nan), points)
        self._map.integrate(
            scan.stamp,
            points,
            pose.transform,
            cloud.covariance_triangles,
            pose.covariance,
            camera=cloud.camera,
            error_correlation=cloud.error_correlation,
        )
        self._on_scan(scan)


def _level(transform: FloatArray) -> FloatArray:
    """The part of a transform that turns about z and shifts, shape (4, 4)."""
    x, y, yaw = planar_pose(transform)
    level = np.eye(4)
    level[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    level[:3, 3] = x, y, transform[2, 3]
    return level
