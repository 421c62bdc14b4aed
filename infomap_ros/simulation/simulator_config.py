"""The parameters of the simulator, gathered from its parts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.motion.base.path_following import PathFollowingConfig
from infomap_ros.simulation.body.base_motion import BaseMotionConfig, DriveTrainConfig
from infomap_ros.simulation.body.dynamics import DynamicsConfig
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.body.wheel_odometry import WheelOdometryConfig
from infomap_ros.simulation.cameras.eyes import DepthEyeConfig
from infomap_ros.simulation.cameras.stereo_camera import ImageSensorConfig, StereoCameraConfig


@dataclass(frozen=True)
class SimulatorConfig:
    """Parameters of the simulator; the parts have their own."""

    seed: int = parameter(1, "Seed of all noise.", low=0)
    start_time: ClassVar[float] = 1_000_000_000.0
    """Stamp of the first moment [s]."""
    start: tuple[float, ...] = parameter(
        (),
        "Where the robot starts: x, y [m] and yaw [rad] in the world. Empty: where the world says; "
        "of several robots in one world each needs a place of its own.",
    )
    joint_noise: ClassVar[float] = 0.0005
    """Standard deviation of the joint positions [rad]."""
    position_noise: ClassVar[float] = 0.003
    """Standard deviation of the measured camera pose [m]."""
    rotation_noise: ClassVar[float] = 0.0026
    """Standard deviation of the measured camera pose [rad]."""
    step_height: float = setting(
        0.06, "What a wheel may touch above its lowest point.", unit="m", low=0.0, high=1.0
    )
    robot: RobotSetupConfig = field(default_factory=RobotSetupConfig)
    dynamics: DynamicsConfig = field(default_factory=DynamicsConfig)
    drive: DriveTrainConfig = field(default_factory=DriveTrainConfig)
    following: PathFollowingConfig = field(default_factory=PathFollowingConfig)
    base: BaseMotionConfig = field(default_factory=BaseMotionConfig)
    odometry: WheelOdometryConfig = field(default_factory=WheelOdometryConfig)
    camera: StereoCameraConfig = field(default_factory=StereoCameraConfig)
    sensor: ImageSensorConfig = field(default_factory=ImageSensorConfig)
    depth: DepthEyeConfig = field(default_factory=DepthEyeConfig)

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)
        if len(self.start) not in (0, 3):
            raise ConfigError("start", self.start, "three numbers x, y, yaw, or none")
