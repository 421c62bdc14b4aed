"""What of a robot is driven, and by what."""

from __future__ import annotations

from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.motion.arm.controller_trajectories import read_controllers
from infomap_ros.motion.base.path_following import PathFollowingConfig

_SECONDS_AHEAD = 0.6  # that a base looks ahead, as the simulated one at its default speed
_ARRIVED = 0.05  # [m or rad]; a real base stands still at the speeds that less would ask for


@dataclass(frozen=True)
class RobotDriverConfig:
    """Which controllers carry out arm_trajectory and base_path, and within which limits.

    Raises:
        ConfigError: a value is out of its range.
    """

    arm: str = parameter(
        "follow_joint_trajectory",
        "What moves the arm: the action follow_joint_trajectory or the topic joint_trajectory "
        "below the name of each controller, or nothing that this node knows of.",
        choices=("follow_joint_trajectory", "joint_trajectory", "none"),
    )
    controllers: tuple[str, ...] = parameter(
        (),
        "Controllers of the arm with all their joints, one each, as 'arm_controller: "
        "shoulder_joint, elbow_joint'.",
    )
    base: str = parameter(
        "follow_path",
        "What drives the base: the actions follow_path or navigate_through_poses of Nav2, this "
        "node on cmd_vel with Twist or with TwistStamped, or nothing that this node knows of.",
        choices=("follow_path", "navigate_through_poses", "cmd_vel", "cmd_vel_stamped", "none"),
    )
    controller_id: str = parameter("", "Controller of follow_path; empty where Nav2 has one only.")
    goal_checker_id: str = parameter(
        "", "Goal checker of follow_path; empty where Nav2 has one only."
    )
    max_speed: float = parameter(0.25, "Largest speed on cmd_vel.", unit="m/s", low=0.01, high=3.0)
    max_turn_rate: float = parameter(
        0.6, "Largest turn rate on cmd_vel.", unit="rad/s", low=0.05, high=5.0
    )
    acceleration: float = parameter(
        0.4, "Largest acceleration on cmd_vel.", unit="m/s^2", low=0.01, high=10.0
    )
    turn_acceleration: float = parameter(
        1.5,
        "Largest acceleration of the turn rate on cmd_vel.",
        unit="rad/s^2",
        low=0.05,
        high=50.0,
    )

    def __post_init__(self) -> None:
        check_config(self)
        read_controllers(self.controllers)

    def following(self) -> PathFollowingConfig:
        """How paths are followed on cmd_vel."""
        return PathFollowingConfig(
            max_speed=self.max_speed,
            max_turn_rate=self.max_turn_rate,
            acceleration=self.acceleration,
            turn_acceleration=self.turn_acceleration,
            look_ahead=max(0.15, _SECONDS_AHEAD * self.max_speed),
            position_tolerance=_ARRIVED,
            angle_tolerance=_ARRIVED,
        )
