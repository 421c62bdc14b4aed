"""The stand-in for hardware: a robot that moves by forces, looks, and estimates where it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    CameraCalibration,
    JointStateRecord,
    OdometryRecord,
    PoseRecord,
    perturb_transform,
)
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion import RobotModel
from infomap_ros.simulation.arm_motion import ArmMotion
from infomap_ros.simulation.base_motion import BaseMotion, BaseMotionConfig
from infomap_ros.simulation.builder import World
from infomap_ros.simulation.contacts import ContactEvent, ContactMonitor
from infomap_ros.simulation.drive_train import DriveTrain, DriveTrainConfig
from infomap_ros.simulation.dynamics import DynamicsConfig
from infomap_ros.simulation.eyes import Eyes, StereoPair
from infomap_ros.simulation.image_sensor import ImageSensorConfig
from infomap_ros.simulation.path_following import PathFollowingConfig
from infomap_ros.simulation.robot_body import PREFIX, RobotBody
from infomap_ros.simulation.robot_setup import RobotSetupConfig
from infomap_ros.simulation.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.wheel_odometry import WheelOdometry, WheelOdometryConfig

_STILL_FOR = 0.4  # [s]
_STILL = np.array([0.004, 0.004, 0.004, 0.01, 0.01, 0.01])  # [m/s, rad/s]
_LONGEST_SWING = 6.0  # [s] after which it is held as it is, come what may
_SETTLING = 3.0  # [s] before the first moment


@dataclass(frozen=True)
class SimulatorConfig:
    """Parameters of the simulator; the parts have their own."""

    seed: int = parameter(1, "Seed of all noise.", low=0)
    start_time: float = parameter(
        1_000_000_000.0, "Stamp of the first moment.", unit="s", low=1.0, high=4e9
    )
    joint_noise: float = parameter(
        0.0005, "Standard deviation of the joint positions.", unit="rad", low=0.0, high=0.1
    )
    position_noise: float = parameter(
        0.003, "Standard deviation of the measured camera pose.", unit="m", low=0.0, high=1.0
    )
    rotation_noise: float = parameter(
        0.0026, "Standard deviation of the measured camera pose.", unit="rad", low=0.0, high=0.5
    )
    step_height: float = parameter(
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

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


class Simulator:
    """A robot in a world, step by step. Same seeds, same commands: same results.

    Commands only take note of what is wanted; `step` carries it out. World and map frame are one;
    the odom frame begins below the robot's first pose, made level.

    Args:
        world: where; no robot in it.
        description: URDF text of the robot.
        config: the parameters.

    Attributes:
        world: as given.
        description: as given.
        config: as given.

    Raises:
        RobotModelError: the description is malformed or lacks a part that the config names.
        SimulationError: MuJoCo refuses the world with the robot.
    """

    def __init__(
        self, world: World, description: str, config: SimulatorConfig | None = None
    ) -> None:
        self.world, self.description = world, description
        self.config = config = config or SimulatorConfig()
        self._body = RobotBody(world, description, config.robot, config.dynamics)
        robot = RobotModel.from_urdf(description, base_frame=config.robot.base_frame)
        seeds = np.random.SeedSequence(config.seed).spawn(4)
        self._rng, odometry, sensor, self._pose_rng = (np.random.default_rng(s) for s in seeds)
        self._arm = ArmMotion(self._body, robot)
        self._drive = DriveTrain(self._body, config.drive, config.following)
        self._base = BaseMotion(self._drive, config.base, config.following)
        self._period = config.dynamics.steps * config.dynamics.timestep
        self._ticks, self._still, self._idle, self._left = 0, 0.0, 0.0, 0.0
        self._settle()
        self._odometry = WheelOdometry(config.odometry, self._body.base_pose(), odometry)
        self._contacts = ContactMonitor(
            self._body.model, PREFIX, self._body.trial, config.robot.casters, config.step_height
        )
        self._eyes = Eyes(self._body, config.camera, config.sensor, sensor)

    def _settle(self) -> None:
        """Let the robot come to rest on its wheels."""
        for _ in range(round(_SETTLING / self._period)):
            self._body.advance()
        self._body.data.time = 0.0
        self._drive.way()

    # Commands

    def command_velocity(self, speed: float, turn_rate: float) -> None:
        """Drive at a speed [m/s] and turn rate [rad/s] for a moment; to be repeated.

        Raises:
            InvalidInputError: not finite.
        """
        if not (np.isfinite(speed) and np.isfinite(turn_rate)):
            raise InvalidInputError("velocity", f"{speed} m/s, {turn_rate} rad/s is not finite")
        self._base.drive(speed, turn_rate)
        self._still = self._idle = 0.0

    def follow_base_path(self, poses: ArrayLike, T_odom_path: FloatArray | None = None) -> None:
        """Drive along base poses and stop at the last.

        Args:
            poses: x, y [m], yaw [rad], shape (K, 3).
            T_odom_path: frame of the poses in the odom frame, shape (4, 4): ``T_odom_map`` as
                localisation has it. None for poses in odom.

        Raises:
            InvalidInputError: wrong shape, no pose, or not finite.
        """
        self._base.follow(np.array(poses, dtype=np.float64), T_odom_path)
        self._still = self._idle = 0.0

    def correct_path(self, T_odom_path: FloatArray) -> None:
        """Tell the robot on its way where localisation now has the frame of its path in odom.

        Without it, a long way ends beside its goal by as much as the odometry has drifted.
        """
        self._base.correct(T_odom_path)

    def follow_arm_trajectory(
        self, names: Sequence[str], positions: ArrayLike, times: ArrayLike
    ) -> None:
        """Move joints along knots (K, n) [rad or m] at times (K,) [s] from now.

        Raises:
            RobotModelError: a joint is unknown.
            InvalidInputError: as `ArmMotion.follow`.
        """
        self._arm.follow(names, positions, times)
        self._still = self._idle = 0.0

    def stop(self) -> None:
        """Stop base and arm."""
        self._base.stop()
        self._arm.stop()

    def step(self, duration: float) -> None:
        """Simulate for a while [s], rounded to control periods; the rest is carried over.

        A robot that has nothing to do and has come to rest is held as it is, which costs nothing.

        Raises:
            InvalidInputError: negative or not finite.
        """
        if not (np.isfinite(duration) and duration >= 0.0):
            raise InvalidInputError("duration", f"{duration} s is negative or not finite")
        self._left += duration
        ticks = int((self._left + 1e-9) / self._period)
        self._left -= ticks * self._period
        for _ in range(ticks):
            self._ticks += 1
            if self.is_moving:
                self._tick()

    def _tick(self) -> None:
        period, body = self._period, self._body
        estimate = self._odometry.planar_pose()
        self._base.update(estimate, body.base_pose(), period)
        self._arm.update(period)
        body.advance()
        body.data.time = self.time
        self._odometry.step(body.base_pose(), self._drive.way(), period)
        self._contacts.update(body.data)
        at_rest = (np.abs(body.base_velocity) < _STILL).all() and body.joint_speed() < 0.02
        commanded = self._base.active or self._arm.active
        self._idle = 0.0 if commanded else self._idle + period
        self._still = self._still + period if at_rest and not commanded else 0.0

    # What is to be known

    @property
    def time(self) -> float:
        """Simulated time from the start [s]."""
        return self._ticks * self._period

    @property
    def stamp(self) -> int:
        """Simulated time as a stamp [ns]."""
        return round((self.config.start_time + self.time) * 1e6) * 1000

    @property
    def is_moving(self) -> bool:
        """Whether a command is being carried out or the robot still swings from it."""
        return self._still < _STILL_FOR and self._idle < _LONGEST_SWING

    @property
    def problem(self) -> str:
        """Why the last commands to base or arm were not carried out; empty where they were."""
        return "; ".join(filter(None, (self._base.problem, self._arm.problem)))

    @property
    def contacts(self) -> int:
        """Number of forbidden contacts so far."""
        return len(self._contacts.events)

    @property
    def contact_events(self) -> tuple[ContactEvent, ...]:
        """The forbidden contacts: when, which link, and what it touched."""
        return tuple(self._contacts.events)

    @property
    def calibrations(self) -> tuple[CameraCalibration, CameraCalibration]:
        """Of the left and the right camera."""
        return self._eyes.camera.left, self._eyes.camera.right

    def capture(self) -> StereoPair:
        """Take a raw stereo pair now.

        Raises:
            SimulationError: this machine cannot draw images.
        """
        return self._eyes.look(self.stamp)

    def joint_state(self) -> JointStateRecord:
        """Positions of all joints, with noise."""
        positions = self._body.joint_positions()
        noise = self._rng.normal(0.0, self.config.joint_noise, len(positions))
        return JointStateRecord(
            self.stamp, "", tuple(positions), np.array(list(positions.values())) + noise
        )

    def odometry(self) -> OdometryRecord:
        """Dead-reckoned ``T_odom_base`` with its covariance."""
        estimate = self._odometry.estimate()
        return OdometryRecord(
            self.stamp,
            "odom",
            estimate.transform,
            estimate.covariance,
            self.config.robot.base_frame,
            estimate.twist,
            estimate.twist_covariance,
        )

    def camera_pose(self) -> PoseRecord:
        """Left optical frame in the map, as a good localisation would measure it."""
        config = self.config
        sigma = np.repeat([config.position_noise, config.rotation_noise], 3)
        measured = perturb_transform(
            self.true_camera_pose(), self._pose_rng.normal(0.0, np.maximum(sigma, 0.0))
        )
        covariance = np.diag(np.maximum(sigma, 1e-6) ** 2)
        frame = self.config.robot.left_camera_frame
        return PoseRecord(self.stamp, "map", measured, covariance, frame)

    def true_pose(self) -> FloatArray:
        """``T_world_base``, shape (4, 4)."""
        return self._body.base_pose()

    def true_camera_pose(self) -> FloatArray:
        """``T_world_camera`` of the left optical frame, shape (4, 4)."""
        return self._body.frame(self.config.robot.left_camera_frame)

    @property
    def T_world_odom(self) -> FloatArray:
        """Where the odom frame truly is, shape (4, 4)."""
        return self._odometry.T_world_odom

    def close(self) -> None:
        """Free what drawing needs."""
        self._eyes.close()
