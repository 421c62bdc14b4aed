"""What is to be mapped, how well, and what it may cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from infomap_ros.errors import ConfigError
from infomap_ros.exploration.robot import MapProgress
from infomap_ros.geometry import Box, PlacedSolid, Polygon, make_transform
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.keep_out import KeepOut
from infomap_ros.views.situation import Interest


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
    interests: tuple[float, ...] = setting(
        (),
        "Places of interest: cubes, five numbers each: x, y, z of the middle in the map frame [m], "
        "edge [m], and the weight of what there is to learn inside. One with a weight above 1 must "
        "be known as the whole region.",
    )
    interest_sigma: float = setting(
        0.0,
        "As surface_sigma, for places of interest with a weight above 1, also those of the topic "
        "interest; 0 for the same.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    keep_out: tuple[str, ...] = setting(
        (),
        "Regions in which no part of the base may be: polygons, a name and at least three corners "
        "x y each, map frame, as 'stairs: 1 0 2 0 2 1.5'. More may come on the topic keep_out.",
        unit="m",
    )
    geofence: tuple[float, ...] = setting(
        (),
        "Corners x0, y0, x1, y1, ... of the polygon that no part of the base may leave, map frame; "
        "empty for none. Another one may come on the topic geofence; then both hold.",
        unit="m",
    )
    max_views: int = parameter(80, "Budget of views.", low=1, high=100000)
    max_distance: float = parameter(
        300.0, "Budget of the distance driven.", unit="m", low=0.0, high=1e6
    )
    max_time: float = parameter(7200.0, "Budget of time.", unit="s", low=1.0, high=1e7)
    max_failures: int = setting(
        5,
        "So many views or motions that fail one after the other end the exploration.",
        low=1,
        high=1000,
    )
    unproductive_views: int = parameter(
        6,
        "The exploration ends where so many views, one after the other, together bring less for "
        "their time than `min_rate`.",
        low=1,
        high=1000,
    )
    min_rate: float = parameter(
        0.01,
        "Least rate at which views make the map more certain, or known precisely enough, as a "
        "share of the best rate that so many views one after the other have had.",
        low=0.0,
        high=1.0,
    )
    max_drift: float = setting(
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
        if self.interest_sigma > self.surface_sigma:
            expected = f"at most surface_sigma {self.surface_sigma}"
            raise ConfigError("interest_sigma", self.interest_sigma, expected)
        try:
            _ = self.places
        except ValueError as error:
            expected = "five numbers a place: x, y, z, an edge above 0, a weight of at least 0"
            raise ConfigError("interests", self.interests, expected) from error
        _ = self.rules

    @cached_property
    def places(self) -> tuple[Interest, ...]:
        """The places of interest."""
        cubes = np.reshape(self.interests, (-1, 5))
        return tuple(
            Interest(
                PlacedSolid(Box((edge,) * 3), make_transform(np.eye(3), (x, y, z)), ""), weight
            )
            for x, y, z, edge, weight in cubes.tolist()
        )

    @cached_property
    def rules(self) -> KeepOut:
        """Where the base must not go.

        Raises:
            ConfigError: a region or the geofence is no polygon.
        """
        try:
            regions = tuple(_region_of(text) for text in self.keep_out)
            if len({region.name for region in regions}) < len(regions):
                raise ValueError("two regions have the same name")
        except ValueError as error:
            expected = f"polygons 'name: x y x y x y ...' ({error})"
            raise ConfigError("keep_out", self.keep_out, expected) from error
        if not self.geofence:
            return KeepOut(regions)
        try:
            return KeepOut(regions, (Polygon.of(_pairs(self.geofence), "of the task"),))
        except ValueError as error:
            expected = f"corners x0, y0, x1, y1, ... of a polygon ({error})"
            raise ConfigError("geofence", self.geofence, expected) from error

    @property
    def precise_sigma(self) -> float:
        """Standard deviation that suffices in places of interest [m]."""
        return self.interest_sigma or self.surface_sigma

    def is_met(self, progress: MapProgress) -> bool:
        """Whether enough of the reachable surface is known, and precisely enough."""
        return progress.min_fraction >= self.known_fraction

    @property
    def region(self) -> FloatArray:
        """The box as (low, high), shape (2, 3), map frame [m]."""
        return np.array([self.region_low, self.region_high])


def _region_of(text: str) -> Polygon:
    """The region of "name: x y x y x y ...".

    Raises:
        ValueError: it is none.
    """
    name, colon, corners = text.partition(":")
    if not colon or not name.strip():
        raise ValueError(f"'{text}' has no name")
    return Polygon.of(_pairs([float(number) for number in corners.split()]), name.strip())


def _pairs(numbers: Sequence[float]) -> list[tuple[float, float]]:
    """Numbers x0, y0, x1, y1, ... as corners.

    Raises:
        ValueError: their number is odd.
    """
    if len(numbers) % 2:
        raise ValueError(f"{len(numbers)} numbers are not pairs x, y")
    return list(zip(numbers[::2], numbers[1::2], strict=True))
