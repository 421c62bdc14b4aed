"""A wheeled robot on rough ground: where it can stand, and why not where it cannot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import degrees
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PlacedSolid, float_array
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.measures import CUBE_SIGMA, SURE
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base import stance as kernels
from infomap_ros.motion.base.stance import TerrainArrays, VehicleArrays
from infomap_ros.motion.base.undercarriage import (
    Undercarriage,
    body_columns,
    center_of_mass,
    footprint_of,
    off_the_ground,
    wheels_of,
)
from infomap_ros.motion.robot.robot_model import RobotModel

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
        "Highest step along 0.1 m under a wheel; 0 for three quarters of the smallest "
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


_STEP = 2  # of VehicleConfig.limits_for
_NOISE = 1.5  # by which the ground may seem worse than it was when the route was planned
_ABOVE = (kernels.TOUCHES_OBSTACLE, kernels.UNSEEN)  # for which the upper end of a column decides
_OF_BODY = (*_ABOVE, kernels.TOUCHES_GROUND, kernels.UNKNOWN_BODY)


@dataclass(frozen=True, eq=False)
class StanceBatch:
    """How the robot stands at N places.

    Attributes:
        T_map_base: shape (N, 4, 4).
        outcomes: as in `infomap_ros.motion.base.stance`, shape (N,).
        measures: columns as in `infomap_ros.motion.base.stance`, shape (N, MEASURES).
    """

    T_map_base: FloatArray
    outcomes: NDArray[np.int64]
    measures: FloatArray

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Where it may stand, shape (N,)."""
        return np.asarray(self.outcomes == kernels.STANDS)


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A robot with its joints at rest, as what drives; immutable.

    Attributes:
        robot: its model.
        config: limits of what it drives on.
        joint_positions: of all its joints [rad or m].
        undercarriage: wheels and support polygon.
        arrays: for kernels.
        wider: by so much the body is taken for wider to all sides [m].
    """

    robot: RobotModel
    config: VehicleConfig
    joint_positions: Mapping[str, float]
    undercarriage: Undercarriage
    arrays: VehicleArrays
    wider: float = 0.0

    @classmethod
    def from_robot(
        cls,
        robot: RobotModel,
        config: VehicleConfig | None = None,
        joint_positions: Mapping[str, float] | None = None,
        wider: float = 0.0,
    ) -> Vehicle:
        """Read the vehicle from a robot model.

        Args:
            robot: the robot.
            config: limits; None for the defaults.
            joint_positions: of its joints while it drives [rad or m]. Joints not named are at
                zero, or at the limit nearest to zero.
            wider: growth of the body to all sides, beyond the margin, not up or down [m].

        Raises:
            RobotModelError: fewer than three wheels and no footprint, wheels in one line, or no
                inertials.
        """
        settings = config or VehicleConfig()
        joints = {j.name: float(np.clip(0.0, j.lower, j.upper)) for j in robot.joints}
        joints.update({k: float(v) for k, v in (joint_positions or {}).items() if k in joints})
        solids = robot.solids_in(robot.base_frame, joints)
        if settings.footprint:
            carriage = footprint_of(settings.footprint, settings.ground_height)
        else:
            carriage = wheels_of(robot, settings.wheel_links, solids)
        wheels = set() if settings.footprint else set(carriage.names)
        body = [solid for solid in solids if solid.name not in wheels]
        limits = settings.limits_for(_smallest_radius(carriage))
        columns = off_the_ground(
            body_columns(body, settings.column_spacing, settings.margin, wider),
            float(carriage.contacts[:, :, 2].min()),
            float(limits[_STEP]),
            settings.margin,
        )
        columns = np.concatenate(
            [columns, _wheel_columns(solids, wheels, carriage, settings, wider)]
        )
        arrays = VehicleArrays(
            carriage.centers,
            np.ascontiguousarray(carriage.contacts),
            columns,
            _inside_polygon(columns[:, :2], carriage.outline),
            carriage.support,
            center_of_mass(robot, joints),
            _reach(columns, carriage, settings.max_slope),
            limits,
        )
        return cls(robot, settings, joints, carriage, arrays, wider)

    def with_joints(self, joint_positions: Mapping[str, float]) -> Vehicle:
        """The same vehicle with some joints elsewhere [rad or m]: other outline, other balance."""
        return Vehicle.from_robot(
            self.robot, self.config, {**self.joint_positions, **joint_positions}, self.wider
        )

    @cached_property
    def without_margin(self) -> Vehicle:
        """The same vehicle, its body no larger than it is."""
        config = replace(self.config, margin=0.0)
        return Vehicle.from_robot(self.robot, config, self.joint_positions)

    @cached_property
    def while_driving(self) -> Vehicle:
        """The same vehicle as the check of a route takes it: what was planned stays good enough.

        Its body is no larger than it is, ground may be rougher by its noise, a step as high as a
        wheel's radius.
        """
        config = replace(
            self.config,
            margin=0.0,
            max_step=float(self.arrays.limits[_STEP]) / _STEP_SHARE,
            max_roughness=_NOISE * self.config.max_roughness,
            min_tip_margin=self.config.min_tip_margin / _NOISE,
        )
        return Vehicle.from_robot(self.robot, config, self.joint_positions)

    def refusal(self, terrain: Terrain, place: FloatArray, q: ArrayLike | None = None) -> str:
        """Why the robot may not stand at a place, in words; empty where it may.

        Args:
            terrain: the ground.
            place: x, y [m, map] and yaw [rad] of the base, shape (3,).
            q: positions of the arm, shape (n,) as of `robot.arm`, for the balance alone; the
                body's outline stays that of the vehicle's own posture.
        """
        batch = self.stances(terrain, np.asarray(place)[None], q)
        outcome = int(batch.outcomes[0])
        closed = "" if outcome == kernels.STANDS else self.closed_at(terrain, *place)
        if closed:
            return f"the base would stand {closed}"
        return self._in_words(outcome, batch.measures[0], batch.T_map_base[0])

    def closed_at(self, terrain: Terrain, x: float, y: float, yaw: float) -> str:
        """What closes the ground under a part of the body, see `Terrain.closed`; or empty."""
        if not terrain.closed:
            return ""
        turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        return terrain.closed_at(self.arrays.columns[:, :2] @ turn + (x, y))

    def _in_words(self, outcome: int, measures: FloatArray, T_map_base: FloatArray) -> str:
        """Why a stance is refused, with the link and the place that decided; or empty."""
        words = outcome, measures, self.arrays.limits, self.undercarriage.names
        if outcome not in _OF_BODY:
            return outcome_in_words(*words)
        x, y, low, high = self.arrays.columns[int(measures[kernels.CULPRIT])]
        point = np.array([x, y, high if outcome in _ABOVE else low])
        at = ", ".join(f"{value:.2f}" for value in T_map_base[:3, :3] @ point + T_map_base[:3, 3])
        return outcome_in_words(*words, self._link_at(point), f" at ({at})")

    def _link_at(self, point: FloatArray) -> str:
        """The link nearest to a point of the base frame, shape (3,)."""
        solids = self.robot.solids_in(self.robot.base_frame, self.joint_positions)
        places = [(point - each.transform[:3, 3]) @ each.transform[:3, :3] for each in solids]
        away = [
            float(each.solid.signed_distance(place[None])[0])
            for each, place in zip(solids, places, strict=True)
        ]
        return solids[int(np.argmin(away))].name

    def stances(
        self, terrain: Terrain, places: ArrayLike, q: ArrayLike | None = None
    ) -> StanceBatch:
        """How the robot stands at many places.

        Args:
            terrain: the ground.
            places: x, y [m, map] and yaw [rad] of the base, shape (N, 3).
            q: as for `refusal`.

        Raises:
            InvalidInputError: `places` or `q` has another shape or is not finite.
        """
        rows = np.ascontiguousarray(float_array(places, "places"))
        if rows.ndim != 2 or rows.shape[1] != 3 or not np.isfinite(rows).all():
            raise InvalidInputError("places", f"shape {rows.shape}, expected (N, 3), finite")
        arrays = self.arrays
        if q is not None:
            joints = {**self.joint_positions, **self.robot.arm.by_name(q)}
            arrays = arrays._replace(center_of_mass=center_of_mass(self.robot, joints))
        poses = np.full((len(rows), 4, 4), np.nan)
        poses[:, 3] = (0.0, 0.0, 0.0, 1.0)
        outcomes = np.empty(len(rows), np.int64)
        measures = np.empty((len(rows), kernels.MEASURES))
        kernels.stand_all(
            terrain_arrays(terrain, self.config), arrays, rows, poses, outcomes, measures
        )
        poses[outcomes == kernels.UNKNOWN_WHEEL, :3] = np.nan
        return StanceBatch(poses, outcomes, measures)


def terrain_arrays(terrain: Terrain, config: VehicleConfig) -> TerrainArrays:
    """A terrain as the kernels take it, for a vehicle of this configuration."""
    heights, roughness, step, floor, overhead, seen = (
        np.ascontiguousarray(getattr(terrain, name), dtype=np.float32)
        for name in TerrainArrays._fields[:6]
    )
    # The noise of level ground must not stop a low body. A plan spends its margin on it, no more,
    # or the body would stand on ground that reaches up to it; the check of a route has none.
    most = config.margin or SURE * CUBE_SIGMA * terrain.resolution
    sure = heights - np.minimum(SURE * terrain.sigma, most)
    bottom = np.where(np.isnan(sure), np.inf, sure).astype(np.float32)
    seen = np.where(seen >= heights + config.seen_height, np.float32(np.inf), seen)
    top = np.minimum(overhead, seen)
    x, y = terrain.origin
    return TerrainArrays(
        heights, roughness, step, floor, overhead, seen, bottom, top, x, y, terrain.resolution
    )


def _wheel_columns(
    solids: Sequence[PlacedSolid], wheels: set[str], carriage: Undercarriage,
    config: VehicleConfig, wider: float,
) -> FloatArray:  # fmt: skip
    """Upper halves of the wheels: what stands beside a wheel higher than its axle is touched."""
    columns = []
    for name, center in zip(carriage.names, carriage.centers, strict=True):
        own = [solid for solid in solids if solid.name == name and name in wheels]
        part = body_columns(own, config.column_spacing, config.margin, wider)
        part[:, 2] = np.maximum(part[:, 2], center[2])
        columns.append(part[part[:, 3] > part[:, 2]])
    return np.concatenate([np.zeros((0, 4)), *columns])


def _smallest_radius(carriage: Undercarriage) -> float:
    """Height of the axle above the lowest point of the smallest wheel [m]."""
    lowest = carriage.contacts[:, :, 2].min(axis=1)
    return float((carriage.centers[:, 2] - lowest).min())


def _reach(columns: FloatArray, carriage: Undercarriage, slope: float) -> float:
    """Horizontal distance of the farthest point from the base, on slopes up to `slope` [rad]."""
    ends = np.concatenate(
        [columns[:, [0, 1, 2]], columns[:, [0, 1, 3]], carriage.contacts.reshape(-1, 3)]
    )
    return float((np.hypot(*ends[:, :2].T) + np.sin(slope) * np.abs(ends[:, 2])).max())


def _inside_polygon(points: FloatArray, corners: FloatArray) -> NDArray[np.bool_]:
    """Which points lie in a convex polygon given counter-clockwise."""
    inside = np.ones(len(points), np.bool_)
    for here, following in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge, offset = following - here, points - here
        inside &= edge[0] * offset[:, 1] - edge[1] * offset[:, 0] >= 0.0
    return inside


def outcome_in_words(
    outcome: int, measures: FloatArray, limits: FloatArray, wheels: tuple[str, ...],
    link: str = "the body", place: str = "",
) -> str:  # fmt: skip
    """A short sentence with the figures that decided; empty for a good stance.

    Args:
        outcome: as in `infomap_ros.motion.base.stance`.
        measures: of the stance, shape (MEASURES,).
        limits: as of `VehicleArrays`.
        wheels: names of the wheels.
        link: of the body, where the stance is refused because of what is there.
        place: where in the map that is, in words.
    """
    if outcome == kernels.STANDS:
        return ""
    if outcome in (kernels.UNKNOWN_WHEEL, kernels.OFF_GROUND):
        return _of_wheel(outcome, measures, limits, wheels[int(measures[kernels.CULPRIT])])
    slope, tip = degrees(measures[kernels.SLOPE]), degrees(measures[kernels.TIP])
    step, rough = measures[kernels.STEP], measures[kernels.ROUGHNESS]
    return {
        kernels.OUTSIDE: "outside the mapped terrain",
        kernels.UNKNOWN_BODY: f"unknown ground under the body ({link}){place}",
        kernels.STEEP: f"slope of {slope:.0f} deg, limit {degrees(limits[1]):.0f} deg",
        kernels.STEPPED: f"step of {step:.3f} m under a wheel, limit {limits[2]:.3f} m",
        kernels.ROUGH: f"roughness of {rough:.3f} m under a wheel, limit {limits[3]:.3f} m",
        kernels.TIPS: f"tip-over margin of {tip:.0f} deg, at least "
        f"{degrees(limits[4]):.0f} deg needed",
        kernels.TOUCHES_GROUND: f"{link} touches the ground or an obstacle on it{place} "
        f"({-measures[kernels.CLEARANCE]:.3f} m too low)",
        kernels.TOUCHES_OBSTACLE: f"{link} touches an obstacle{place}",
        kernels.UNSEEN: f"{link} enters space that was never seen{place}",
    }[outcome]


def _of_wheel(outcome: int, measures: FloatArray, limits: FloatArray, wheel: str) -> str:
    if outcome == kernels.UNKNOWN_WHEEL:
        return f"unknown ground under {wheel}"
    misfit = measures[kernels.MISFIT]
    travel = limits[0]
    return (
        f"{wheel} is {misfit:.3f} m off the plane of the wheels, suspension allows {travel:.3f} m"
    )
