"""Which robot is simulated: what its description does not say and the simulation must know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting


@dataclass(frozen=True)
class RobotSetupConfig:
    """Parameters of the simulated robot; what is empty is read from its description.

    `infomap_ros.simulation.robots.ready_robot` completes it. A robot drives with the wheels of two
    sides (skid steer, or differential drive with casters). All its other moving joints are held and
    moved by servos; joints without range or effort are fixed.
    """

    base_frame: str = setting("", "Link whose pose is the robot's; the root link where empty.")
    left_wheels: tuple[str, ...] = parameter(
        (), "Joints of the driven left wheels; by the description's geometry where empty."
    )
    right_wheels: tuple[str, ...] = parameter(
        (), "Joints of the driven right wheels; by the description's geometry where empty."
    )
    casters: tuple[str, ...] = parameter((), "Links that slide on the ground without friction.")
    hovering: tuple[str, ...] = setting(
        (), "Links that are drawn down to the ground, and in truth are clear of it."
    )
    arm_joints: tuple[str, ...] = setting(
        (),
        "Joints whose start position `home` gives; all between base and camera where empty. The "
        "others start as near zero as they can.",
    )
    home: tuple[float, ...] = parameter(
        (),
        "Start positions of arm_joints [rad or m]. Empty: what <ros2_control> of the description "
        "has as initial_value, else as near zero as they can.",
    )
    held: tuple[str, ...] = setting(
        (),
        "Start positions of joints that are not of arm_joints, as joint:position [rad or m], for "
        "example of a second arm, so that it is not in the way.",
    )
    mimics: tuple[str, ...] = parameter(
        (),
        "Joints that follow another although the description does not say so, as follower:leader.",
    )
    left_camera_frame: str = parameter(
        "", "Optical frame of the left camera; the one of the description's pair where empty."
    )
    right_camera_frame: str = parameter(
        "", "Optical frame of the right camera. Empty: at `baseline` along x of the left one."
    )
    baseline: float = parameter(
        0.0,
        "Distance of the cameras where right_camera_frame is empty.",
        unit="m",
        low=0.0,
        high=2.0,
    )
    camera_mount: str = setting(
        "",
        "Where left_camera_frame is added to a description that lacks it, as a fixed joint has it: "
        "'link: x y z roll pitch yaw' [m, rad].",
    )
    cart: tuple[float, ...] = setting(
        (),
        "Put under a description without driven wheels: length, width and height [m] of a box on "
        "two driven wheels and four casters, on which its root stands. Height 0: wheels alone.",
    )
    suspension_sag: float = setting(
        0.008,
        "How far the wheels' springs give under the robot's weight; 0 for rigid wheels.",
        unit="m",
        low=0.0,
        high=0.2,
    )
    suspension_travel: ClassVar[float] = 0.04
    """Travel of a wheel up and down from rest [m]."""
    suspension_warp: ClassVar[float] = 0.05
    """Stiffness against uneven ground, as share of that against a shift of the load."""
    suspension_damping: ClassVar[float] = 0.4
    """Damping of the springs as share of the critical."""
    wheel_friction: float = setting(
        1.0, "Friction coefficient of the wheels on the ground.", low=0.05, high=3.0
    )
    rollers: bool = setting(
        False,
        "The wheels have rollers, as mecanum wheels: they move the base as they are told, and "
        "resist a push to any side.",
    )
    wheel_effort: ClassVar[float] = 8.0
    """Largest torque of a wheel whose joint has no effort limit [Nm]."""

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)
        if self.home and self.arm_joints and len(self.home) != len(self.arm_joints):
            expected = f"{len(self.arm_joints)} numbers, one for each of arm_joints"
            raise ConfigError("home", self.home, expected)
        if len(self.cart) not in (0, 3) or any(side < 0.0 for side in self.cart):
            raise ConfigError("cart", self.cart, "length, width, height, or nothing")
        if self.camera_mount:
            _ = self.mounted_camera
        _ = self.held_positions
        for entry in self.mimics:
            if len(entry.split(":")) != 2:
                raise ConfigError("mimics", entry, "follower:leader")

    @property
    def leaders(self) -> dict[str, str]:
        """Leader of each joint in `mimics`."""
        pairs = (entry.split(":") for entry in self.mimics)
        return {follower.strip(): leader.strip() for follower, leader in pairs}

    @property
    def held_positions(self) -> dict[str, float]:
        """Position of each joint in `held` [rad or m].

        Raises:
            ConfigError: an entry has another form.
        """
        found = {}
        for entry in self.held:
            name, _, number = entry.partition(":")
            try:
                found[name.strip()] = float(number)
            except ValueError as error:
                raise ConfigError("held", entry, "joint:position [rad or m]") from error
        return found

    @property
    def mounted_camera(self) -> tuple[str, tuple[float, ...]]:
        """Link of `camera_mount`, and x, y, z [m], roll, pitch, yaw [rad] on it.

        Raises:
            ConfigError: `camera_mount` has another form.
        """
        link, _, numbers = self.camera_mount.partition(":")
        try:
            place = tuple(float(number) for number in numbers.split())
        except ValueError:
            place = ()
        if not link.strip() or len(place) != 6:
            expected = "'link: x y z roll pitch yaw'"
            raise ConfigError("camera_mount", self.camera_mount, expected)
        return link.strip(), place

    @property
    def wheels(self) -> tuple[str, ...]:
        """Joints of all driven wheels, left ones first."""
        return self.left_wheels + self.right_wheels
