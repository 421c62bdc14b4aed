"""Everything that the choice of the next view depends on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, PlacedSolid, check_covariance, check_transform
from infomap_ros.geometry.transforms import FloatArray, check_transforms, float_array
from infomap_ros.mapping import VoxelMap

GroundHeight = Callable[[FloatArray], FloatArray]
"""Height of the ground at places, (N, 2) [m, map] -> (N,) [m, map], NaN where unknown."""
MOST_WEIGHT = 1e6
"""Of a place of interest."""
_FARTHEST = 1e6  # [m]


@dataclass(frozen=True, eq=False)
class RegionOfTask:
    """Box that is to be mapped; information outside it is not wanted.

    Attributes:
        low: smallest x, y, z [m, map]; -inf for no limit.
        high: largest x, y, z [m, map]; inf for no limit.

    Raises:
        InvalidInputError: it is not a box.
    """

    low: FloatArray = field(default_factory=lambda: np.full(3, -np.inf))
    high: FloatArray = field(default_factory=lambda: np.full(3, np.inf))

    def __post_init__(self) -> None:
        low, high = float_array(self.low, "region low"), float_array(self.high, "region high")
        if low.shape != (3,) or high.shape != (3,) or not (low < high).all():
            raise InvalidInputError("region", f"{low.tolist()} to {high.tolist()} is not a box")
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)

    def contains(self, points: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Which points, shape (..., 3) [m, map], lie in the box grown by `margin` [m]."""
        places = np.asarray(points, dtype=np.float64)
        inside = (places >= self.low - margin) & (places <= self.high + margin)
        return np.asarray(inside.all(axis=-1))


@dataclass(frozen=True, eq=False)
class Interest:
    """A place whose information counts more, or less, than that of others.

    Attributes:
        place: box, sphere or other solid in the map frame.
        weight: factor on the information of the voxels inside: 1 is neutral, 0 not wanted at all.

    Raises:
        InvalidInputError: the weight is not from 0 to `MOST_WEIGHT`, or the place is not within
            1000 km.
    """

    place: PlacedSolid
    weight: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.weight <= MOST_WEIGHT:
            expected = f"expected 0 to {MOST_WEIGHT:g}"
            raise InvalidInputError("interest", f"has weight {self.weight}, {expected}")
        reach = np.abs(self.place.transform[:3, 3]).max() + self.place.solid.bounding_radius
        if not reach < _FARTHEST:
            raise InvalidInputError(
                "interest", f"reaches {reach:g} m far, expected 1000 km at most"
            )


@dataclass(frozen=True, eq=False)
class Teammate:
    """Another robot: where it is, and what it is about to see.

    Attributes:
        position: of its camera or base, or the middle of its body, shape (3,) [m, map].
        goal: ``T_map_camera`` of the view that it is heading for, shape (4, 4), None if unknown.
        max_range: how far its camera sees [m].
        camera: its camera; None where it is like one's own.
        radius: of its body about `position` [m].
        stand: where the middle of its body is going to be, shape (3,) [m, map], None if unknown.

    Raises:
        InvalidInputError: a position, pose or range is impossible.
    """

    position: FloatArray
    goal: FloatArray | None = None
    max_range: float = 5.0
    camera: PinholeCamera | None = None
    radius: float = 0.0
    stand: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("position", "stand"):
            if getattr(self, name) is None:
                continue
            place = float_array(getattr(self, name), f"teammate {name}")
            if place.shape != (3,) or not np.isfinite(place).all():
                raise InvalidInputError(f"teammate {name}", f"is {place.tolist()}")
            object.__setattr__(self, name, place)
        if not (np.isfinite(self.radius) and self.radius >= 0.0):
            raise InvalidInputError("teammate radius", f"is {self.radius} m")
        if self.goal is not None:
            object.__setattr__(self, "goal", check_transform(self.goal, "teammate goal"))
        _check_range(self.max_range, "teammate max_range")

    def places(self) -> list[tuple[FloatArray, float]]:
        """Where it is or is going to be: middles, shape (3,) [m, map], and radii [m]."""
        places = [(self.position, self.radius)]
        if self.stand is not None:
            places.append((self.stand, self.radius))
        if self.goal is not None:
            places.append((np.asarray(self.goal[:3, 3]), 0.0))
        return places


@dataclass(frozen=True)
class MotionTimes:
    """How long a robot takes to bring its camera from one view to another, and to look.

    Attributes:
        speed: of the base [m/s].
        turn_rate: of the base [rad/s].
        arm: time of a usual motion between a view and the posture for driving [s].
        arm_rate: angle by which the arm turns the camera in a second [rad/s].
        arm_reach: the arm alone brings the camera so far [m].
        look: time of a look [s].

    Raises:
        InvalidInputError: a speed is not positive, or a time negative.
    """

    speed: float = 0.25
    turn_rate: float = 0.6
    arm: float = 3.0
    arm_rate: float = 0.5
    arm_reach: float = 0.5
    look: float = 0.0

    def __post_init__(self) -> None:
        values = (self.speed, self.turn_rate, self.arm, self.arm_rate, self.arm_reach, self.look)
        least = min(self.speed, self.turn_rate, self.arm_rate)
        if not (np.isfinite(values).all() and least > 0.0 and min(values) >= 0.0):
            raise InvalidInputError("motion times", f"are {self}")


@dataclass(frozen=True, eq=False)
class Situation:
    """What is known when the next view is chosen.

    Attributes:
        voxel_map: what has been seen.
        camera: the rectified left camera.
        max_range: how far it sees [m].
        T_map_camera: where it is (optical frame), shape (4, 4).
        pose_covariance: of that pose, shape (6, 6), convention of `geometry.transforms`.
        region: what is to be mapped.
        interests: places whose information counts more or less.
        teammates: the other robots.
        past_views: ``T_map_camera`` of the views taken before, as far as known, shape (V, 4, 4).
        kept_shares: share of what each of them could tell that it has told, shape (V,), NaN where
            that is not known; empty where it is known of none. See `unproductive_looks.GainPrior`.
        free_body: the robot's own body in the map frame: space that is free whatever the map says.
        clear_space: space that is declared free, map frame; what the map knows to be occupied is.
        heights: lowest and highest place that the camera can be brought to [m]: z of the map, or
            above the ground where `ground_height` is given; equal for a camera at one height.
        elevations: least and greatest angle of its optical axis above the horizontal [rad].
        ground_height: height of the ground at a place.
        promising: the map by which it is judged what views are expected to tell, see
            `views.unproductive_looks`; `voxel_map` where not given.
        arm_views: ``T_map_camera`` that the arm can take while the base stays, shape (A, 4, 4);
            candidates besides those that are drawn.
        times: of the robot's motions, for a cost in seconds.

    Raises:
        InvalidInputError: a pose, covariance, range or shape is impossible.
    """

    voxel_map: VoxelMap
    camera: PinholeCamera
    max_range: float
    T_map_camera: FloatArray
    pose_covariance: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    region: RegionOfTask = field(default_factory=RegionOfTask)
    interests: Sequence[Interest] = ()
    teammates: Sequence[Teammate] = ()
    past_views: FloatArray = field(default_factory=lambda: np.empty((0, 4, 4)))
    kept_shares: FloatArray = field(default_factory=lambda: np.empty(0))
    free_body: Sequence[PlacedSolid] = ()
    clear_space: Sequence[PlacedSolid] = ()
    heights: tuple[float, float] = (-np.inf, np.inf)
    elevations: tuple[float, float] = (-0.5 * np.pi, 0.5 * np.pi)
    ground_height: GroundHeight | None = None
    promising: VoxelMap | None = None
    arm_views: FloatArray = field(default_factory=lambda: np.empty((0, 4, 4)))
    times: MotionTimes = field(default_factory=MotionTimes)

    def __post_init__(self) -> None:
        pose = check_transform(self.T_map_camera, "T_map_camera")
        object.__setattr__(self, "T_map_camera", pose)
        covariance = check_covariance(self.pose_covariance, 6, "pose_covariance")
        object.__setattr__(self, "pose_covariance", covariance)
        _check_range(self.max_range, "max_range")
        for name in ("heights", "elevations"):
            low, high = getattr(self, name)
            if not low <= high:
                raise InvalidInputError(name, f"{low:g} to {high:g} is not a band")
        past = float_array(self.past_views, "past_views").reshape(-1, 4, 4)
        object.__setattr__(self, "past_views", past)
        shares = float_array(self.kept_shares, "kept_shares")
        if shares.shape not in ((0,), (len(past),)):
            raise InvalidInputError("kept_shares", f"shape {shares.shape} for {len(past)} views")
        object.__setattr__(self, "kept_shares", shares)
        views = check_transforms(self.arm_views, "arm_views")
        object.__setattr__(self, "arm_views", views)

    @property
    def promising_map(self) -> VoxelMap:
        """The map by which it is judged what views are expected to tell."""
        return self.voxel_map if self.promising is None else self.promising

    @property
    def position(self) -> FloatArray:
        """Where the camera is, shape (3,) [m, map]."""
        return np.asarray(self.T_map_camera[:3, 3])

    @property
    def is_planar(self) -> bool:
        """Whether the region of the task is one layer of voxels, along which the camera looks."""
        depth = float(self.region.high[2] - self.region.low[2])
        return depth <= self.voxel_map.config.voxel_size * (1.0 + 1e-9)

    def heights_of(self, points: FloatArray) -> FloatArray:
        """Heights of points, (N, 3) [m, map] -> (N,) [m], as `heights` counts them."""
        if self.ground_height is None:
            return np.asarray(points[:, 2])
        return np.asarray(points[:, 2] - self.ground_height(points[:, :2]))


def _check_range(value: float, name: str) -> None:
    if not (np.isfinite(value) and value > 0.0):
        raise InvalidInputError(name, f"is {value} m, expected a positive range")
