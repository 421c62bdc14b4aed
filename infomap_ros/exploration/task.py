"""What is to be mapped, how well, and what it may cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True)
class TaskConfig:
    """A mapping task.

    It is done when expanse and resolution suffice (Fig. 3 of Sujan and Dubowsky 2005): the
    `known_fraction` of the reachable surface is in the map, with a standard deviation of at most
    `surface_sigma`.

    Raises:
        ConfigError: a value is out of its range, or the region is empty.
    """

    region_low: tuple[float, ...] = parameter(
        (-3.0, -3.0, -0.6), "Lower corner of the box that is to be mapped, map frame.", unit="m"
    )
    region_high: tuple[float, ...] = parameter(
        (3.0, 3.0, 1.4), "Upper corner of the box that is to be mapped, map frame.", unit="m"
    )
    known_fraction: float = parameter(
        0.95,
        "Share of the reachable surface in the region that must be known, as precisely as "
        "surface_sigma says.",
        low=0.0,
        high=1.0,
    )
    surface_sigma: float = parameter(
        0.03,
        "Standard deviation along its normal with which a surface is known precisely enough.",
        unit="m",
        low=1e-5,
        high=10.0,
    )
    max_views: int = parameter(80, "Budget of views.", low=1, high=100000)
    max_distance: float = parameter(
        300.0, "Budget of the way of the base.", unit="m", low=0.0, high=1e6
    )
    max_time: float = parameter(7200.0, "Budget of time.", unit="s", low=1.0, high=1e7)
    max_failures: int = setting(
        5,
        "So many views or motions that fail one after the other end the exploration.",
        low=1,
        high=1000,
    )
    vain_views: int = setting(
        6,
        "The exploration ends where so many views, one after the other, together bring less than "
        "`least_gain` and less than `least_growth`.",
        low=1,
        high=1000,
    )
    least_gain: float = setting(
        0.001,
        "Share of the reachable surface that must become known for views not to be in vain; while "
        "the mean standard deviation is larger than asked, also the share by which it shrinks.",
        low=0.0,
        high=1.0,
    )
    least_growth: float = setting(
        0.01,
        "Share by which the number of surface voxels must grow for views not to be in vain.",
        low=0.0,
        high=1.0,
    )
    most_drift: float = setting(
        0.06,
        "A motion on which the standard deviation of where the base is grows by more than this is "
        "broken off: the robot looks and chooses again.",
        unit="m",
        low=0.001,
        high=100.0,
    )

    view_position_tolerance: float = setting(
        0.1,
        "The camera has reached a view when it is this near to it. Else the arm's motion is "
        "planned again from where the base stands, to within half of it: the other half is for "
        "errors of joints and poses.",
        unit="m",
        low=1e-3,
        high=10.0,
    )
    view_angle_tolerance: float = setting(
        0.15,
        "And when its viewing direction differs by no more than this, with halves as above.",
        unit="rad",
        low=1e-3,
        high=3.2,
    )

    def __post_init__(self) -> None:
        check_config(self)
        for name in ("region_low", "region_high"):
            if len(getattr(self, name)) != 3:
                raise ConfigError(name, getattr(self, name), "three coordinates x, y, z")
        if not all(low < high for low, high in zip(self.region_low, self.region_high, strict=True)):
            raise ConfigError("region_high", self.region_high, f"above {self.region_low}")

    def is_met(self, precise_fraction: float) -> bool:
        """Whether the share of the reachable surface that is known precisely suffices, 0 to 1."""
        return precise_fraction >= self.known_fraction

    @property
    def region(self) -> FloatArray:
        """The box as (low, high), shape (2, 3), map frame [m]."""
        return np.array([self.region_low, self.region_high])
