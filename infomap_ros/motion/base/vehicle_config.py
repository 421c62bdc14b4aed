"""What a vehicle drives on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray

_STEP_SHARE = 0.75  # of a wheel's radius that it climbs


@dataclass(frozen=True)
class VehicleConfig:
    """Limits of the ground that a vehicle stands and drives on.

    Raises:
        ConfigError: a value is out of its range, or a footprint comes without `max_step`.
    """

    wheel_links: str = parameter(
        "*_wheel,wheel_*,*caster*",
        "Links that are wheels or casters: file-name patterns, separated by commas. Links without "
        "a collision shape are left out.",
    )
    footprint: tuple[float, ...] = parameter(
        (),
        "Corners x0, y0, x1, y1, ... on which a robot rests whose wheels are not to be read from "
        "its description, base frame. Empty for the wheels.",
        unit="m",
    )
    ground_height: float = parameter(
        0.0, "Height of the ground in the base frame, for a footprint.", unit="m", low=-10.0,
        high=10.0,
    )  # fmt: skip
    suspension_travel: float = setting(
        0.03, "How far a wheel may be above or below the plane of all wheels.", unit="m", low=0.0,
        high=1.0,
    )  # fmt: skip
    max_slope: float = parameter(
        0.44, "Steepest plane of the wheels (25 degrees).", unit="rad", low=0.0, high=1.5
    )
    max_step: float = parameter(
        0.0,
        "Highest step from cell to cell under a wheel; 0 for three quarters of the smallest "
        "wheel's radius.",
        unit="m",
        low=0.0,
        high=1.0,
    )
    max_roughness: float = setting(
        0.03, "Largest roughness of the ground under a wheel.", unit="m", low=0.0, high=1.0
    )
    min_tip_margin: float = setting(
        0.25, "Smallest angle by which it must turn to fall over.", unit="rad", low=0.0, high=1.5
    )
    margin: float = setting(
        0.02,
        "Growth of the body against ground and obstacles where its pose is known exactly.",
        unit="m",
        low=0.0,
        high=1.0,
    )
    margin_sigmas: float = setting(
        2.0,
        "So many standard deviations of where it is are added to the margin to the sides, in "
        "squares.",
        low=0.0,
        high=10.0,
    )
    max_margin: float = setting(
        0.08, "The margin to the sides grows no further than this.", unit="m", low=0.0, high=1.0
    )
    seen_height: float = parameter(
        0.8,
        "Space over known ground must have been seen up to this height, if the body is so high, "
        "before the base enters it. What is higher, as about the head of a tall robot, need not: "
        "hardly anything is there where the floor is free up to the height of a table, and the "
        "camera looks ahead while the base drives. 0: nothing must have been seen.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    column_spacing: ClassVar[float] = 0.05
    """Edge of the squares into which the body is divided [m]."""

    def __post_init__(self) -> None:
        check_config(self)
        if self.footprint and self.max_step == 0.0:
            raise ConfigError("max_step", self.max_step, "more than 0 m where a footprint is given")

    def limits_for(self, radius: float) -> FloatArray:
        """As `infomap_ros.motion.base.stance.VehicleArrays` holds them, shape (6,).

        Args:
            radius: of the smallest wheel [m].
        """
        return np.array(
            [
                self.suspension_travel,
                self.max_slope,
                self.max_step or _STEP_SHARE * radius,
                self.max_roughness,
                self.min_tip_margin,
                float(self.seen_height == 0.0),
            ]
        )
