"""The stand-in for hardware: a robot that moves by forces, looks, and estimates where it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import CameraCalibration
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoardConfig
from infomap_ros.motion.base.path_following import PathFollowingConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.urdf import Follower, read_followers
from infomap_ros.simulation.body.arm_motion import ArmMotion
from infomap_ros.simulation.body.base_motion import (
    BaseMotion,
    BaseMotionConfig,
    DriveTrain,
    DriveTrainConfig,
)
from infomap_ros.simulation.body.contacts import ContactEvent, ContactMonitor
from infomap_ros.simulation.body.dynamics import DynamicsConfig
from infomap_ros.simulation.body.extended_description import extended_description
from infomap_ros.simulation.body.robot_body import PREFIX, RobotBody
from infomap_ros.simulation.body.robot_sensors import RobotSensors
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.body.saved_robot import SavedRobot
from infomap_ros.simulation.body.wheel_odometry import WheelOdometryConfig
from infomap_ros.simulation.cameras.eyes import (
    DepthEye,
    DepthImage,
    Eyes,
    StereoPair,
)
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.robots.ready_robot import ready_robot
from infomap_ros.simulation.worlds.builder import World

import mujoco  # isort: skip  # after the backend has been chosen


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
    robot: RobotSetupConfig = field(default_factory=RobotSetupConfig)
    dynamics: DynamicsConfig = field(default_factory=DynamicsConfig)
    drive: DriveTrainConfig = field(default_factory=DriveTrainConfig)
    following: PathFollowingConfig = field(default_factory=PathFollowingConfig)
    base: BaseMotionConfig = field(default_factory=BaseMotionConfig)
    odometry: WheelOdometryConfig = field(default_factory=WheelOdometryConfig)
    camera: StereoCameraConfig = field(default_factory=StereoCameraConfig)

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)
        if len(self.start) not in (0, 3):
            raise ConfigError("start", self.start, "three numbers x, y, yaw, or none")


__all__ = ["Simulator", "SimulatorConfig"]

_STEP_HEIGHT = 0.06  # what a wheel may touch above its lowest point [m]
_STILL_FOR = 0.4  # [s]
_STILL = np.array([0.004, 0.004, 0.004, 0.01, 0.01, 0.01])  # [m/s, rad/s]
_LONGEST_SWING = 6.0  # [s] after which it is held as it is, come what may
_SETTLING = 3.0  # [s] before the first moment


class Simulator(RobotSensors):
    """A robot in a world, step by step. Same seeds, same commands: same results.

    Commands only take note of what is wanted; `step` carries it out. World and map frame are one;
    the odom frame begins below the robot's first pose, made level.

    Args:
        world: where; no robot in it.
        description: URDF text of the robot.
        config: the parameters.
        teammates: URDF texts of other robots in this world, by name. They are not simulated here:
            `place_teammate` tells where they are.
        tags: that hang on the bases of teammates, by their names.

    Attributes:
        world: as given, the robot's own start in it.
        description: as given, with the camera or cart that the config adds.
        config: as given, the robot's setup completed from the description.
        mended: what of the description could not be used as it is, and was taken for.

    Raises:
        RobotModelError: the description is malformed or lacks a part that the config names.
        ConfigError: the config leaves a part open that the description leaves open too.
        SimulationError: MuJoCo refuses the world with the robot.
    """

    def __init__(
        self,
        world: World,
        description: str,
        config: SimulatorConfig | None = None,
        teammates: Mapping[str, str] | None = None,
        tags: Mapping[str, TagBoardConfig] | None = None,
    ) -> None:
        config = config or SimulatorConfig()
        ready = ready_robot(description, config.robot)
        description, setup = ready.description, ready.setup
        config, self.mended = replace(config, robot=setup), ready.mended
        others = {
            name: extended_description(text, setup) for name, text in (teammates or {}).items()
        }
        if config.start:
            x, y, yaw = config.start
            world = replace(world, start=(x, y, yaw))
        self.world, self.description = world, description
        body = RobotBody(world, description, setup, config.dynamics, others, tags)
        seeds = np.random.SeedSequence(config.seed).spawn(5)
        joints, odometry, images, poses, depths = (np.random.default_rng(seed) for seed in seeds)
        self._drive = DriveTrain(body, config.drive, config.following)
        self._settle(body, config.dynamics.steps * config.dynamics.timestep)
        super().__init__(body, config, (joints, odometry, poses))
        self._arm = ArmMotion(body, *_joints_of(description, setup))
        self._base = BaseMotion(self._drive, config.base, config.following)
        self._still, self._idle, self._left = 0.0, 0.0, 0.0
        self._contacts_before = 0
        self._contacts = ContactMonitor(
            body.model, PREFIX, body.trial, setup.casters, _STEP_HEIGHT, body.teammates
        )
        self._eyes = Eyes(body, config.camera, images)
        self._depth_eye = DepthEye(body, self._eyes.camera.rig.left, depths)

    @property
    def saved(self) -> SavedRobot:
        """What is left when the power goes now."""
        return SavedRobot(self.time, self.contacts, self._body.state(), self._odometry.state())

    def resume(self, saved: SavedRobot, off: float) -> None:
        """Stand as a robot that was switched off, and go on from there.

        Args:
            saved: in the same world.
            off: for how long it was switched off [s].

        Raises:
            SimulationError: it is another robot.
        """
        self._body.restore(saved.body)
        self._odometry.restore(saved.odometry, self._body.base_pose())
        self._ticks = round((saved.seconds + off) / self._period)
        self._contacts_before = saved.contacts
        self._drive.restart()
        self.stop()

    def place_teammate(
        self, name: str, T_world_base: FloatArray, joints: Mapping[str, float]
    ) -> None:
        """Tell where another robot truly is. It is seen from now on, and in the way.

        Args:
            name: of the other robot.
            T_world_base: pose of its base, shape (4, 4).
            joints: its joint positions by name [rad or m].

        Raises:
            InvalidInputError: there is no such robot.
            RobotModelError: it has no such joint.
        """
        if name not in self._body.teammates:
            known = ", ".join(self._body.teammates) or "none"
            raise InvalidInputError("teammate", f"'{name}' is unknown; known: {known}")
        self._body.teammates[name].place(T_world_base, joints)

    def _settle(self, body: RobotBody, period: float) -> None:
        """Let the robot come to rest on its wheels."""
        for _ in range(round(_SETTLING / period)):
            body.advance()
        body.data.time = 0.0
        self._drive.distance_rolled()

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
                localization has it. None for poses in odom.

        Raises:
            InvalidInputError: wrong shape, no pose, or not finite.
        """
        self._base.follow(np.array(poses, dtype=np.float64), T_odom_path)
        self._still = self._idle = 0.0

    def correct_path(self, T_odom_path: FloatArray) -> None:
        """Tell the robot on its way where localization now has the frame of its path in odom.

        Without it, a long path ends beside its goal by as much as the odometry has drifted.
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
        self.stop_base()
        self._arm.stop()

    def stop_arm(self) -> None:
        """Stop the arm; the base goes on."""
        self._arm.stop()

    def stop_base(self) -> None:
        """Stop the base; the arm goes on."""
        self._base.stop()

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
        self._odometry.step(body.base_pose(), self._drive.distance_rolled(), period)
        self._contacts.update(body.data)
        at_rest = (np.abs(body.base_velocity) < _STILL).all() and body.joint_speed() < 0.02
        commanded = self._base.active or self._arm.active
        self._idle = 0.0 if commanded else self._idle + period
        self._still = self._still + period if at_rest and not commanded else 0.0

    def skip(self, duration: float) -> None:
        """Let time pass in which the robot is switched off and stands as it is.

        Raises:
            InvalidInputError: negative or not finite.
        """
        if not (np.isfinite(duration) and duration >= 0.0):
            raise InvalidInputError("duration", f"{duration} s is negative or not finite")
        self._ticks += round(duration / self._period)
        self._body.data.time = self.time

    # What is to be known

    @property
    def is_moving(self) -> bool:
        """Whether a command is being carried out or the robot still swings from it."""
        return self._still < _STILL_FOR and self._idle < _LONGEST_SWING

    @property
    def problem(self) -> str:
        """Why the last commands to base or arm were not carried out; empty where they were."""
        return "; ".join(filter(None, (self._base.problem, self._arm.problem)))

    @property
    def advice(self) -> str:
        """Which setting makes the base swing or creep when it turns; empty for none."""
        return self._drive.advice

    @property
    def skids(self) -> bool:
        """Whether wheels skid where the base turns: two on one side, one behind the other."""
        return self._drive.skids

    @property
    def turn_gain(self) -> float:
        """The `turn_gain` that is used."""
        return self._drive.gain

    @property
    def fitting_turn_gain(self) -> float:
        """The `turn_gain` by which the base would have turned as told; 0 before it has turned."""
        return self._drive.fitting_gain

    @property
    def arm_joints(self) -> tuple[str, ...]:
        """The joints that trajectories can name."""
        return self._arm.joints

    @property
    def arm_motion(self) -> tuple[bool, str]:
        """Whether a trajectory is being followed, and why the last one was not; or empty."""
        return self._arm.active, self._arm.problem

    @property
    def base_motion(self) -> tuple[bool, str]:
        """Whether the base is being driven, and why the last path was not; or empty."""
        return self._base.active, self._base.problem

    @property
    def scene(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """World and robot as MuJoCo has them, to be drawn; not to be written to."""
        return self._body.model, self._body.data

    @property
    def contacts(self) -> int:
        """Number of forbidden contacts so far, before `resume` too."""
        return self._contacts_before + len(self._contacts.events)

    @property
    def contact_events(self) -> tuple[ContactEvent, ...]:
        """The forbidden contacts since it was made: when, which link, and what it touched."""
        return tuple(self._contacts.events)

    @property
    def calibrations(self) -> tuple[CameraCalibration, CameraCalibration]:
        """Of the left and the right camera."""
        return self._eyes.camera.left, self._eyes.camera.right

    @property
    def depth_calibration(self) -> CameraCalibration:
        """Of the depth image, which has no distortion."""
        return self._depth_eye.calibration

    def capture(self) -> StereoPair:
        """Take a raw stereo pair now.

        Raises:
            SimulationError: this machine cannot draw images.
        """
        return self._eyes.look(self.stamp)

    def capture_depth(self) -> DepthImage:
        """Take a depth image now, from the place of the left camera, undistorted.

        Raises:
            SimulationError: this machine cannot draw images.
        """
        return self._depth_eye.look(self.stamp)

    def close(self) -> None:
        """Free what drawing needs."""
        self._eyes.close()
        self._depth_eye.close()


def _joints_of(description: str, setup: RobotSetupConfig) -> tuple[RobotModel, dict[str, Follower]]:
    """The robot's kinematics, and its joints that follow others."""
    robot = RobotModel.from_urdf(description, base_frame=setup.base_frame, mimics=setup.leaders)
    return robot, read_followers(ElementTree.fromstring(description), setup.leaders)
