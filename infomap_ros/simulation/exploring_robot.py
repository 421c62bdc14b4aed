"""The simulated robot as the exploration sees it: commands, waits, looks, and fuses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from infomap_ros.exploration.loop import planar_pose
from infomap_ros.exploration.robot import Interrupted, Motion, RobotState
from infomap_ros.geometry import StereoRig, invert_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.body import BodyFilterConfig, body_mask
from infomap_ros.motion import RobotModel
from infomap_ros.motion.route import ArmPath
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.stereo import StereoConfig, StereoRangeSensor, StereoRectifier


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

    Attributes:
        rig: the rectified stereo pair.
    """

    def __init__(
        self,
        simulator: Simulator,
        robot: RobotModel,
        voxel_map: VoxelMap,
        config: ExploringRobotConfig | None = None,
    ) -> None:
        self._simulator, self._robot, self._map = simulator, robot, voxel_map
        self._config = config or ExploringRobotConfig()
        self._rectifier = StereoRectifier(*simulator.calibrations)
        self.rig: StereoRig = self._rectifier.rig
        self._sensor = StereoRangeSensor(self.rig, self._config.stereo)

    def state(self) -> RobotState:
        """Where it is, as localisation and joint encoders measure it."""
        pose, joints = self._simulator.camera_pose(), self._joints()
        T_base_camera = self._robot.forward_kinematics(joints, self._robot.camera_frame)
        assert pose.covariance is not None
        T_map_base = pose.transform @ invert_transform(T_base_camera)
        return RobotState(T_map_base, pose.transform, pose.covariance, joints)

    def look(self, interrupted: Interrupted) -> str:
        """Take stereo pairs from here and fuse them."""
        for _ in range(self._config.scans_per_view):
            if interrupted():
                return "broken off"
            self._simulator.step(self._config.scan_period)
            self._fuse_pair()
        return ""

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

    def _T_odom_map(self) -> FloatArray:
        """Where localisation and odometry together have the map, level, shape (4, 4)."""
        odometry = self._simulator.odometry().transform
        return _level(odometry @ invert_transform(self.state().T_map_base))

    def _finish(self, interrupted: Interrupted, camera: bool) -> tuple[str, list[list[float]]]:
        """Let the simulation run until the robot rests; the problem, and where it came by."""
        simulator, begin = self._simulator, self._simulator.time
        places = [self._place(camera)]
        while simulator.is_moving:
            if interrupted() or simulator.time - begin > self._config.motion_timeout:
                simulator.stop()
                simulator.step(1.0)
                late = f"not done after {self._config.motion_timeout:g} s"
                return ("broken off" if interrupted() else late), places
            simulator.step(self._config.tick)
            if not camera:
                simulator.correct_path(self._T_odom_map())
            place = self._place(camera)
            if np.linalg.norm(np.subtract(place, places[-1])) > 0.02:
                places.append(place)
        return simulator.problem, places

    def _place(self, camera: bool) -> list[float]:
        simulator = self._simulator
        pose = simulator.true_camera_pose() if camera else simulator.true_pose()
        return [float(number) for number in pose[:3, 3]]

    def _joints(self) -> dict[str, float]:
        record = self._simulator.joint_state()
        return dict(zip(record.names, map(float, record.positions), strict=True))

    def _fuse_pair(self) -> None:
        """One stereo pair into the map, without the robot's own body."""
        pair, joints = self._simulator.capture(), self._joints()
        pose = self._simulator.camera_pose()
        cloud = self._sensor.measure(*self._rectifier.rectify(pair.left, pair.right))
        points = cloud.organised_points
        body = self._robot.solids_in(self._robot.camera_frame, joints)
        on_body = body_mask(points, cloud.covariance_triangles, body, self._config.body)
        points = np.where(on_body[..., None], np.float32(np.nan), points)
        self._map.integrate(
            points,
            pose.transform,
            cloud.covariance_triangles,
            pose.covariance,
            camera=cloud.camera,
            error_correlation=cloud.error_correlation,
        )


def _level(transform: FloatArray) -> FloatArray:
    """The part of a transform that turns about z and shifts, shape (4, 4)."""
    x, y, yaw = planar_pose(transform)
    level = np.eye(4)
    level[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    level[:3, 3] = x, y, transform[2, 3]
    return level
