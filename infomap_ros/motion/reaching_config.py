"""How a robot with an arm on a base reaches views."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.mapping.terrain.terrain import TerrainConfig
from infomap_ros.motion.arm.arm_path import ArmPathConfig
from infomap_ros.motion.arm.trajectory import TrajectoryConfig
from infomap_ros.motion.base.base_path import BasePlannerConfig
from infomap_ros.motion.base.path_following import PathFollowingConfig
from infomap_ros.motion.base.vehicle_config import VehicleConfig
from infomap_ros.motion.collision.collision_config import CollisionConfig


@dataclass(frozen=True)
class ReachingConfig:
    """How near a view must be reached, and with how much effort.

    Raises:
        ConfigError: a value is out of its range.
    """

    position_tolerance: float = setting(
        0.05, "A view counts as reached when the camera is this near to it.", unit="m",
        low=1e-4, high=10.0,
    )  # fmt: skip
    direction_tolerance: ClassVar[float] = 0.1
    """And when its viewing direction differs by no more than this; the roll is free [rad]."""
    postures: int = setting(
        30000, "Random postures of the arm from which places for the base are derived.",
        low=100, high=10**7,
    )  # fmt: skip
    stances: ClassVar[int] = 400
    """Places for the base that are looked at for one view."""
    goals: ClassVar[int] = 5
    """Of these, the nearest good ones that are given to the planner of the base."""
    min_approach: ClassVar[float] = 0.3
    """A way that does not lead to the view is offered where it brings the base nearer by more
    than this [m].
    """
    clear_body: ClassVar[float] = 0.05
    """Space within this of the robot's present body is free though it was never seen [m]."""
    driving_posture: tuple[float, ...] = parameter(
        (), "Positions of the arm's joints while the base drives; a compact posture is looked for "
        "where empty.", unit="rad or m",
    )  # fmt: skip
    collision: CollisionConfig = field(default_factory=CollisionConfig)
    arm_path: ArmPathConfig = field(default_factory=ArmPathConfig)
    trajectory: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    terrain: TerrainConfig = field(default_factory=TerrainConfig)
    vehicle: VehicleConfig = field(default_factory=VehicleConfig)
    base: BasePlannerConfig = field(default_factory=BasePlannerConfig)
    following: PathFollowingConfig = field(default_factory=PathFollowingConfig)

    def __post_init__(self) -> None:
        check_config(self)
