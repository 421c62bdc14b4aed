"""Which robot is simulated: what its description does not say and the simulation must know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting


@dataclass(frozen=True)
class RobotSetupConfig:
    """Parameters of the simulated robot; the defaults are those of ``config/rover.urdf``.

    A robot drives with the wheels of two sides (skid steer, or differential drive with casters).
    All its other moving joints are held and moved by servos; joints without range or effort are
    fixed.
    """

    base_frame: str = parameter("base_link", "Link whose pose is the robot's.")
    left_wheels: tuple[str, ...] = parameter(
        ("front_left_wheel_joint", "rear_left_wheel_joint"), "Joints of the driven left wheels."
    )
    right_wheels: tuple[str, ...] = parameter(
        ("front_right_wheel_joint", "rear_right_wheel_joint"), "Joints of the driven right wheels."
    )
    casters: tuple[str, ...] = parameter((), "Links that slide on the ground without friction.")
    hovering: tuple[str, ...] = setting(
        (), "Links that are drawn down to the ground, and in truth are clear of it."
    )
    arm_joints: tuple[str, ...] = parameter(
        ("arm_pan_joint", "arm_shoulder_joint", "arm_elbow_joint", "arm_wrist_joint"),
        "Joints whose start position `home` gives; the others start as near zero as they can.",
    )
    home: tuple[float, ...] = parameter(
        (0.0, -0.35, 0.65, 0.0), "Start positions of arm_joints [rad or m]."
    )
    mimics: tuple[str, ...] = parameter(
        (),
        "Joints that follow another although the description does not say so, as follower:leader.",
    )
    left_camera_frame: str = parameter(
        "left_camera_optical_frame", "Optical frame of the left camera."
    )
    right_camera_frame: str = parameter(
        "right_camera_optical_frame",
        "Optical frame of the right camera. Empty: at `baseline` along x of the left one.",
    )
    baseline: float = parameter(
        0.0,
        "Distance of the cameras where right_camera_frame is empty.",
        unit="m",
        low=0.0,
        high=2.0,
    )
    suspension_sag: float = setting(
        0.008,
        "How far the wheels' springs give under the robot's weight; 0 for rigid wheels.",
        unit="m",
        low=0.0,
        high=0.2,
    )
    suspension_travel: ClassVar[float] = 0.04
    """Way of a wheel up and down from rest [m]."""
    suspension_warp: ClassVar[float] = 0.05
    """Stiffness against uneven ground, as share of that against a shift of the load."""
    suspension_damping: ClassVar[float] = 0.4
    """Damping of the springs as share of the critical."""
    wheel_friction: float = setting(
        1.0, "Friction coefficient of the wheels on the ground.", low=0.05, high=3.0
    )
    wheel_effort: ClassVar[float] = 8.0
    """Largest torque of a wheel whose joint has no effort limit [Nm]."""

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)
        for name in ("left_wheels", "right_wheels"):
            if not getattr(self, name):
                raise ConfigError(name, (), "at least one joint")
        if len(self.home) != len(self.arm_joints):
            expected = f"{len(self.arm_joints)} numbers, one for each of arm_joints"
            raise ConfigError("home", self.home, expected)
        if not self.right_camera_frame and self.baseline < 0.005:
            raise ConfigError("baseline", self.baseline, "at least 0.005 m without right camera")

        for entry in self.mimics:
            if len(entry.split(":")) != 2:
                raise ConfigError("mimics", entry, "follower:leader")

    @property
    def leaders(self) -> dict[str, str]:
        """Leader of each joint in `mimics`."""
        pairs = (entry.split(":") for entry in self.mimics)
        return {follower.strip(): leader.strip() for follower, leader in pairs}

    @property
    def wheels(self) -> tuple[str, ...]:
        """Joints of all driven wheels, left ones first."""
        return self.left_wheels + self.right_wheels
