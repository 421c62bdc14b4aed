"""What planning a way of the base gives, and what it is planned by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True)
class BasePlannerConfig:
    """How a way of the base is looked for.

    Raises:
        ConfigError: a value is out of its range.
    """

    samples: int = setting(
        2000,
        "Random places that OMPL tries for a path better than the lattice's; 0 to drive that.",
        low=0,
        high=10**9,
    )
    reach: float = setting(
        1.0, "Longest motion by which OMPL's trees grow.", unit="m", low=0.05, high=100.0
    )
    reverse: bool = parameter(True, "Whether the robot may drive backwards.")
    turning_radius: float = parameter(
        0.0, "Smallest radius on which the robot turns; 0 if it turns in place.", unit="m", low=0.0,
        high=50.0,
    )  # fmt: skip
    turn_cost: float = setting(
        0.2, "Length that a turn by one radian counts as.", unit="m/rad", low=0.0, high=0.35
    )
    escape: float = setting(
        0.25, "A robot that stands where it should not may leave over up to this distance.",
        unit="m", low=0.0, high=5.0,
    )  # fmt: skip
    standing_reach: float = setting(
        0.2, "Ground around the body that counts as known because the robot stands there.",
        unit="m", low=0.0, high=5.0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class BasePath:
    """A way of the base: turns in place and straight lines, forwards or backwards.

    Attributes:
        poses: x, y [m] and yaw [rad] in the map, shape (K, 3), never more than a cell of the
            terrain or `drive_space.TURN_STEP` apart, yaw continuous; empty where the robot
            cannot move at all.
        T_map_base: how it stands at each, shape (K, 4, 4).
        length: [m].
        complete: whether it leads to a goal; else it is the farthest safe approach.
        reason: why it is not complete, in words; empty where it is.
        goal: index of the goal that it leads or comes nearest to; -1 for none.
        method: what found it: ompl, lattice, or nothing.
    """

    poses: FloatArray
    T_map_base: FloatArray
    length: float
    complete: bool
    reason: str
    goal: int
    method: str

    @property
    def turning(self) -> float:
        """Sum of all turns [rad]."""
        return float(np.abs(np.diff(self.poses[:, 2])).sum()) if len(self.poses) else 0.0
