"""Ground truth for exploration: what can be seen from where a robot can look, and what is mapped.

Everything here comes from the true geometry of the world, nothing from a map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from infomap_ros.errors import InvalidInputError, SimulationError
from infomap_ros.geometry import transform_points
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.simulation.worlds.builder import World

_GRID = 0.05  # [m] of the raster in which obstacles are looked for
_LEVELS = 5  # heights at which the faces of obstacles are looked for


@dataclass(frozen=True)
class ReachableViewsConfig:
    """What a robot can do; the defaults are cautious for ``config/rover.urdf``."""

    footprint_radius: float = parameter(
        0.32, "Radius about the base that must be free.", unit="m", low=0.0, high=5.0
    )
    step_height: float = parameter(
        0.06,
        "What is lower than this above the ground is no obstacle.",
        unit="m",
        low=0.0,
        high=1.0,
    )
    head_room: float = parameter(
        1.1, "Obstacles are looked for up to this height.", unit="m", low=0.1, high=5.0
    )
    max_slope: float = parameter(0.35, "Steepest ground.", unit="rad", low=0.0, high=1.5)
    camera_heights: tuple[float, ...] = parameter(
        (0.35, 0.6, 0.85), "Heights of the camera above the ground.", unit="m", low=0.0, high=10.0
    )
    camera_reach: float = parameter(
        0.3, "How far beside the base the camera can be held.", unit="m", low=0.0, high=5.0
    )
    camera_clearance: float = parameter(
        0.12, "Distance that the camera keeps from everything.", unit="m", low=0.0, high=5.0
    )
    spacing: float = parameter(
        0.3, "Distance of neighboring base places.", unit="m", low=0.05, high=5.0
    )
    max_cameras: int = parameter(
        800, "Of more camera positions so many are kept, by chance.", low=1, high=1000000
    )
    seed: int = parameter(1, "Seed of that chance.", low=0)

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


def standable_places(world: World, config: ReachableViewsConfig | None = None) -> FloatArray:
    """Places where the base can stand, connected with the start.

    Args:
        world: the true world; its region bounds the places.
        config: the parameters.

    Returns:
        Points on the ground, shape (N, 3) [m].

    Raises:
        SimulationError: the region has no bounds, or the start itself is not free.
    """
    config = config or ReachableViewsConfig()
    x, y = _axes(world, config.footprint_radius + 0.3)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    ground = world.terrain.height(grid)
    reached = _connected(world, _free(world, grid, ground, config), x, y)
    every = max(1, round(config.spacing / _GRID))
    kept = np.zeros_like(reached)
    kept[::every, ::every] = True
    kept &= ((grid >= world.region[0, :2]) & (grid <= world.region[1, :2])).all(axis=-1)
    places = np.concatenate([grid, ground[..., None]], axis=-1)
    return np.asarray(places[reached & kept])


def reachable_cameras(world: World, config: ReachableViewsConfig | None = None) -> FloatArray:
    """Positions where the camera can be held: above the standable places and beside them.

    Args:
        world: the true world.
        config: the parameters.

    Returns:
        shape (M, 3) [m].

    Raises:
        SimulationError: as `standable_places`.
    """
    config = config or ReachableViewsConfig()
    places = standable_places(world, config)
    bearings = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)
    ring = config.camera_reach * np.column_stack([np.cos(bearings), np.sin(bearings)])
    found = []
    for height in config.camera_heights:
        middle = places + np.array((0.0, 0.0, height))
        middle = middle[_sees(world, places + np.array((0.0, 0.0, 0.1)), middle)]
        found.append(middle)
        for offset in ring if config.camera_reach > 0.0 else ():
            beside = middle + np.append(offset, 0.0)
            found.append(beside[_sees(world, middle, beside)])
    cameras = np.concatenate(found)
    cameras = cameras[world.surface_distance(cameras) > config.camera_clearance]
    chosen = np.random.default_rng(config.seed).permutation(len(cameras))[: config.max_cameras]
    return cameras[np.sort(chosen)]


def _axes(world: World, margin: float) -> tuple[FloatArray, FloatArray]:
    low, high = world.region
    if not np.isfinite(world.region).all():
        raise SimulationError("the world has no bounded region to be explored")
    x, y = (np.arange(low[k] - margin, high[k] + margin, _GRID) for k in range(2))
    return x, y


def _free(
    world: World, grid: FloatArray, ground: FloatArray, config: ReachableViewsConfig
) -> NDArray[np.bool_]:
    """Cells over which no obstacle is and whose ground is not too steep, footprint included."""
    blocked = np.zeros(ground.shape, dtype=bool)
    levels = np.linspace(config.step_height, config.head_room, _LEVELS)
    layers = [np.concatenate([grid, ground[..., None] + z], axis=-1) for z in levels]
    blocked |= ~_sees(world, layers[-1].reshape(-1, 3), layers[0].reshape(-1, 3)).reshape(
        ground.shape
    )
    for layer in layers:  # the faces of what is higher than the robot
        for axis in (0, 1):
            beside = layer + 0.5 * _GRID * np.eye(3)[axis]
            before = layer - 0.5 * _GRID * np.eye(3)[axis]
            free = _sees(world, before.reshape(-1, 3), beside.reshape(-1, 3))
            blocked |= ~free.reshape(ground.shape)
    smooth = ndimage.gaussian_filter(ground, config.footprint_radius / (2.0 * _GRID))
    slope = np.hypot(*np.gradient(smooth, _GRID))
    blocked |= slope > np.tan(config.max_slope)
    return np.asarray(ndimage.distance_transform_edt(~blocked) * _GRID > config.footprint_radius)


def _connected(
    world: World, free: NDArray[np.bool_], x: FloatArray, y: FloatArray
) -> NDArray[np.bool_]:
    labels, _ = ndimage.label(free)
    start = labels[np.argmin(np.abs(x - world.start[0])), np.argmin(np.abs(y - world.start[1]))]
    if start == 0:
        raise SimulationError("the robot cannot stand at the world's start")
    return np.asarray(labels == start)


def _sees(world: World, origins: FloatArray, ends: FloatArray) -> NDArray[np.bool_]:
    return np.isinf(world.surface.first_hits(origins, ends))


_LIFT = 0.003  # [m] off the surface, so that a point does not hide itself
_CELL = 0.06  # [m] and
_RAYS = 400_000  # of all cameras together, to find the surface that is hidden for sure


@dataclass(frozen=True)
class VisibleSurfaceConfig:
    """When a point of the surface counts as visible."""

    spacing: float = parameter(
        0.04, "Distance of neighboring points of the surface.", unit="m", low=0.005, high=1.0
    )
    nearest: float = parameter(
        0.25, "Smallest distance from the camera.", unit="m", low=0.0, high=10.0
    )
    steepest: float = parameter(
        1.2, "Largest angle between line of sight and normal.", unit="rad", low=0.1, high=1.57
    )
    lowest: float = parameter(
        -1.45, "Lowest elevation of the line of sight.", unit="rad", low=-1.57, high=1.57
    )
    highest: float = parameter(
        1.0, "Highest elevation of the line of sight.", unit="rad", low=-1.57, high=1.57
    )
    views: int = parameter(
        2, "From so many camera positions it must be visible...", low=1, high=1000
    )
    tries: int = parameter(
        120, "...of so many, by chance, that are within range.", low=1, high=100000
    )
    max_points: int = parameter(
        1_000_000, "Of more points that may be visible so many are kept, by chance.", low=1
    )
    seed: int = parameter(1, "Seed of the points' places and of that chance.", low=0)

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


@dataclass(frozen=True, eq=False)
class VisibleSurface:
    """Points of the true surface that can be seen.

    Attributes:
        points: shape (N, 3), world frame [m].
        normals: outward, shape (N, 3).
        cameras: positions from which they were looked for, shape (M, 3) [m].
    """

    points: FloatArray
    normals: FloatArray
    cameras: FloatArray


def visible_surface(
    world: World,
    max_range: float,
    config: VisibleSurfaceConfig | None = None,
    reach: ReachableViewsConfig | None = None,
    cameras: FloatArray | None = None,
) -> VisibleSurface:
    """The surface within the world's region that reachable views can see.

    Args:
        world: the true world.
        max_range: range of the camera [m].
        config: when a point counts as visible.
        reach: where cameras can be.
        cameras: positions in place of those of `reach`, shape (M, 3) [m].

    Raises:
        SimulationError: the world has no bounded region, or its start is not free.
    """
    config = config or VisibleSurfaceConfig()
    cameras = reachable_cameras(world, reach) if cameras is None else cameras
    rng = np.random.default_rng(config.seed)
    points, normals = world.surface.samples(config.spacing, rng)
    inside = ((points >= world.region[0]) & (points <= world.region[1])).all(axis=1)
    inside[inside] = _near_hits(world, cameras, max_range, points[inside], rng)
    kept = rng.permutation(np.flatnonzero(inside))[: config.max_points]
    points, normals = points[np.sort(kept)], normals[np.sort(kept)]
    limits = (
        config.nearest,
        max_range,
        float(np.cos(config.steepest)),
        float(np.sin(config.lowest)),
        float(np.sin(config.highest)),
        _LIFT,
    )
    seen = world.surface.count_views(points, normals, cameras, limits, config.views, config.tries)
    visible = seen >= min(config.views, len(cameras))
    return VisibleSurface(points[visible], normals[visible], cameras)


def _near_hits(
    world: World,
    cameras: FloatArray,
    max_range: float,
    points: FloatArray,
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Which points are near to where a ray of any camera ends: the others are hidden for sure.

    Most of the surface of rocks that lie in each other is of that kind.
    """
    origins = np.repeat(cameras, -(-_RAYS // max(1, len(cameras))), axis=0)
    rays = rng.standard_normal(origins.shape)
    rays *= max_range / np.linalg.norm(rays, axis=1, keepdims=True)
    shares = world.surface.first_hits(origins, origins + rays)
    hit = np.isfinite(shares)
    low = points.min(axis=0) - _CELL
    shape = np.floor((points.max(axis=0) - low) / _CELL).astype(int) + 2
    ends = np.floor((origins[hit] + shares[hit, None] * rays[hit] - low) / _CELL).astype(int)
    near = np.zeros(shape, dtype=bool)
    near[tuple(ends[((ends >= 0) & (ends < shape)).all(axis=1)].T)] = True
    near = ndimage.binary_dilation(near, np.ones((3, 3, 3), dtype=bool))
    return np.asarray(near[tuple(np.floor((points - low) / _CELL).astype(int).T)])


def covered(
    voxel_map: VoxelMap, points: FloatArray, tolerance: float | None = None
) -> NDArray[np.bool_]:
    """Which points of the true surface are in a map.

    Args:
        voxel_map: the map.
        points: shape (N, 3), in the map's frame [m].
        tolerance: largest distance to the mean of a surface voxel [m]; None = the voxel size.

    Returns:
        shape (N,).
    """
    _, means, _ = voxel_map.gaussians()
    if not len(means):
        return np.zeros(len(points), dtype=bool)
    limit = voxel_map.config.voxel_size if tolerance is None else tolerance
    distances, _ = cKDTree(means).query(points, distance_upper_bound=limit)
    return np.isfinite(distances)


def surface_coverage(
    voxel_map: VoxelMap, points: FloatArray, tolerance: float | None = None
) -> float:
    """Share of points of the true surface that are in a map; see `covered`.

    Raises:
        InvalidInputError: no points.
    """
    if not len(points):
        raise InvalidInputError("points", "there are none")
    return float(covered(voxel_map, points, tolerance).mean())


@dataclass(frozen=True, eq=False)
class MapErrors:
    """How far a map's surface is from the true one, along the true normals.

    Attributes:
        points: means of the surface voxels, in the world, shape (N, 3) [m].
        distances: to the true surface, shape (N,) [m].
        sigmas: what the map says of them, along the true normal, shape (N,) [m].
    """

    points: FloatArray
    distances: FloatArray
    sigmas: FloatArray

    @property
    def normalized(self) -> FloatArray:
        """Distances in sigmas, shape (N,)."""
        return self.distances / self.sigmas

    def share_within(self, sigmas: float) -> float:
        """Share of surface voxels within so many sigmas of the true surface."""
        return float((self.normalized <= sigmas).mean())

    @property
    def root_mean_square(self) -> float:
        """Root mean square of the normalized distances: 1 where the map is as good as it says."""
        return float(np.sqrt(np.mean(self.normalized**2)))


def map_errors(
    voxel_map: VoxelMap, world: World, T_world_map: FloatArray | None = None
) -> MapErrors:
    """Compare a map with the true surface of its world.

    Args:
        voxel_map: the map.
        world: the true world.
        T_world_map: where the map's frame truly is, shape (4, 4); the world's where not given.
    """
    _, means, covariances = voxel_map.gaussians()
    T = np.eye(4) if T_world_map is None else T_world_map
    means, covariances = transform_points(T, means), T[:3, :3] @ covariances @ T[:3, :3].T
    match = world.surface.closest(means)
    variances = np.einsum("ni,nij,nj->n", match.normals, covariances, match.normals)
    return MapErrors(means, match.distances, np.sqrt(variances))
