"""Ground truth for exploration: what can be seen from where a robot can look, and what is mapped.

Everything here comes from the true geometry of the world, nothing from a map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import transform_points
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.simulation.exploring.reachable_views import ReachableViewsConfig, reachable_cameras
from infomap_ros.simulation.worlds.builder import World

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
    ways = rng.standard_normal(origins.shape)
    ways *= max_range / np.linalg.norm(ways, axis=1, keepdims=True)
    shares = world.surface.first_hits(origins, origins + ways)
    hit = np.isfinite(shares)
    low = points.min(axis=0) - _CELL
    shape = np.floor((points.max(axis=0) - low) / _CELL).astype(int) + 2
    ends = np.floor((origins[hit] + shares[hit, None] * ways[hit] - low) / _CELL).astype(int)
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
