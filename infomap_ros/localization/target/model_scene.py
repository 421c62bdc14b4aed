"""What a range map offers to the search for a model: thinned points with normals.

The outer surface of a CAD model as points with normals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.mesh_files import read_triangles
from infomap_ros.geometry.transforms import FloatArray, float_array
from infomap_ros.stereo import RangeCloud

_NEIGHBORS = 16
_VAGUE = 1.25  # points with a larger sigma, in spacings, are left out
_NORMALS_AT_ONCE = 20_000
_MOST_PLANES = 8
_PLANES_TRIED, _COUNTED = 100, 4000
_FEWEST_ON_PLANE = 50  # points; fewer are no large plane


@dataclass(frozen=True, eq=False)
class ModelScene:
    """A range map prepared for the search.

    Attributes:
        cloud: the range map.
        points: thinned, shape (S, 3) [m].
        normals: towards the camera, shape (S, 3).
        tree: of `points`, for nearest neighbors.
    """

    cloud: RangeCloud
    points: FloatArray
    normals: FloatArray
    tree: cKDTree

    @classmethod
    def of_cloud(cls, cloud: RangeCloud, spacing: float) -> ModelScene:
        """Prepare a range map.

        Args:
            cloud: in the camera frame.
            spacing: of the thinned points [m].
        """
        certain = cloud.covariances[:, 2, 2] < (_VAGUE * spacing) ** 2
        points = _cube_means(cloud.points[certain].astype(np.float64), spacing)
        tree = cKDTree(points)
        if len(points) <= _NEIGHBORS:
            return cls(cloud, points[:0], points[:0], tree)
        return cls(cloud, points, _normals(points, tree), tree)

    def thinned(self, spacing: float) -> tuple[FloatArray, FloatArray]:
        """One point per cube of that edge [m], with its normal, shape (M, 3) each."""
        _, first = np.unique(_cubes(self.points, spacing), return_index=True)
        return self.points[first], self.normals[first]


def on_large_planes(
    points: FloatArray, normals: FloatArray, extent: float, tolerance: float
) -> NDArray[np.bool_]:
    """Points on planes that reach farther than a model does, as floors and walls.

    Planes are tried through random points with their normals; the one with most points is taken
    out, again and again until the largest is not larger than `extent`.

    Args:
        points: shape (N, 3) [m].
        normals: shape (N, 3).
        extent: [m].
        tolerance: distance from a plane that counts as on it [m].
    """
    rng = np.random.default_rng(0)
    left = np.ones(len(points), bool)
    for _ in range(_MOST_PLANES):
        rest = np.flatnonzero(left)
        if len(rest) < 100:
            break
        sample = rng.choice(rest, min(len(rest), _COUNTED), replace=False)
        tried = rng.choice(rest, _PLANES_TRIED)
        offsets = np.einsum("ni,ni->n", points[tried], normals[tried])
        near = np.abs(points[sample] @ normals[tried].T - offsets) < tolerance
        near &= normals[sample] @ normals[tried].T > 0.9
        best = int(np.argmax(near.sum(axis=0)))
        on = np.abs(points[rest] @ normals[tried[best]] - offsets[best]) < 2.0 * tolerance
        on &= normals[rest] @ normals[tried[best]] > 0.8
        if on.sum() < _FEWEST_ON_PLANE:
            break
        spread = np.linalg.svd(np.cov(points[rest[on]].T), compute_uv=False)
        if np.sqrt(12.0 * spread[0]) < extent:
            break
        left[rest[on]] = False
    return ~left


def _cubes(points: FloatArray, spacing: float) -> FloatArray:
    """A number for the cube that each point is in, shape (N,)."""
    cells = np.floor(points / spacing).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    size = cells.max(axis=0, initial=0) + 1
    return np.asarray((cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2])


def _cube_means(points: FloatArray, spacing: float) -> FloatArray:
    """Mean of the points in each cube, shape (M, 3)."""
    _, group = np.unique(_cubes(points, spacing), return_inverse=True)
    counts = np.bincount(group) if len(group) else np.zeros(0)
    sums = [np.bincount(group, points[:, axis], len(counts)) for axis in range(3)]
    return np.asarray(np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None])


def _normals(points: FloatArray, tree: cKDTree) -> FloatArray:
    """Direction of least spread among the neighbors, towards the camera, shape (N, 3)."""
    normals = np.empty_like(points)
    for first in range(0, len(points), _NORMALS_AT_ONCE):
        part = slice(first, first + _NORMALS_AT_ONCE)
        _, index = tree.query(points[part], k=_NEIGHBORS)
        near = points[index] - points[index].mean(axis=1, keepdims=True)
        _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
        normals[part] = axes[:, :, 0]
    away = np.einsum("ni,ni->n", normals, points) > 0.0
    return np.where(away[:, None], -normals, normals)


_SAMPLES = 60_000
_DIRECTIONS = 60  # from which the outside is looked at
_CERTAIN = 3.0  # sum of cosines under which a sample was seen from them
_ACROSS = 80  # cells of a look across the model


@dataclass(frozen=True, eq=False)
class ModelShape:
    """Points on the surface that can be seen from outside.

    Attributes:
        points: in the model's frame, shape (N, 3) [m].
        normals: unit vectors out of the model, shape (N, 3).

    Raises:
        InvalidInputError: shapes differ, too few points, or no extent.
    """

    points: FloatArray
    normals: FloatArray

    def __post_init__(self) -> None:
        points = float_array(self.points, "points")
        normals = float_array(self.normals, "normals")
        if points.ndim != 2 or points.shape[1] != 3 or normals.shape != points.shape:
            shapes = f"shapes {points.shape} and {normals.shape}, expected (N, 3) twice"
            raise InvalidInputError("points, normals", shapes)
        if len(points) < 100:
            raise InvalidInputError("points", f"{len(points)}, expected at least 100")
        if not (np.isfinite(points).all() and np.isfinite(normals).all()):
            raise InvalidInputError("points, normals", "hold NaN or infinity")
        lengths = np.linalg.norm(normals, axis=1)
        if not (np.abs(lengths - 1.0) < 1e-3).all():
            raise InvalidInputError("normals", "are not unit vectors")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "normals", normals)
        if self.diameter <= 0.0:
            raise InvalidInputError("points", "are all the same")

    @cached_property
    def center(self) -> FloatArray:
        """Middle of the bounding box, shape (3,) [m]."""
        return np.asarray(0.5 * (self.points.min(axis=0) + self.points.max(axis=0)))

    @cached_property
    def diameter(self) -> float:
        """Diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def thinned(self, spacing: float) -> ModelShape:
        """One point per cube of that edge [m]: the one nearest to the cube's mean."""
        keys = np.floor(self.points / spacing).astype(np.int64)
        _, group = np.unique(keys, axis=0, return_inverse=True)
        group = np.ravel(group)
        counts = np.bincount(group)
        means = np.stack([np.bincount(group, self.points[:, i]) / counts for i in range(3)], axis=1)
        distance = np.linalg.norm(self.points - means[group], axis=1)
        order = np.lexsort((distance, group))
        first = order[np.searchsorted(group[order], np.arange(len(counts)))]
        return ModelShape(self.points[first], self.normals[first])


def load_model(path: str | Path, scale: float = 1.0) -> ModelShape:
    """Read a mesh in any format that Assimp knows (.obj, .stl, .ply, .dae, ...).

    Args:
        path: file.
        scale: meters per unit of the file.

    Returns:
        Its outer surface, evenly sampled.

    Raises:
        InvalidInputError: there is no such file, or it holds no triangles with an area.
    """
    if not Path(path).is_file():
        raise InvalidInputError("model file", f"{path} does not exist")
    return shape_from_triangles(read_triangles(path, scale))


def shape_from_triangles(triangles: FloatArray, seed: int = 0) -> ModelShape:
    """Sample the outer surface of a mesh.

    Which way a triangle faces is found by looking from outside, so that neither their order nor
    parts that reach into each other matter.

    Args:
        triangles: corners, shape (F, 3, 3) [m].
        seed: of the places of the samples.

    Raises:
        InvalidInputError: no triangle has an area.
    """
    corners = float_array(triangles, "triangles")
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(across, axis=1)
    if not np.isfinite(corners).all() or not areas.sum() > 0.0:
        raise InvalidInputError("triangles", "no triangle has an area, or one is not finite")
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(areas), _SAMPLES, p=areas / areas.sum())
    u, v = rng.random((2, _SAMPLES, 1))
    over = (u + v) > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    first, second, third = (corners[chosen, i] for i in range(3))
    points = first + u * (second - first) + v * (third - first)
    normals = across[chosen] / areas[chosen, None]
    facing = _outside(points, normals)
    seen = facing != 0
    return ModelShape(points[seen], normals[seen] * facing[seen, None])


def directions(count: int) -> FloatArray:
    """Unit vectors spread evenly over the sphere (Fibonacci's spiral), shape (count, 3)."""
    i = np.arange(count) + 0.5
    height = 1.0 - 2.0 * i / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * i
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def _outside(points: FloatArray, normals: FloatArray) -> FloatArray:
    """1 or -1 where a sample is seen from the side of its normal or from behind, 0 if unseen."""
    extent = float(np.ptp(points, axis=0).max())
    score = np.zeros(len(points))
    for direction in directions(_DIRECTIONS):
        side = np.cross(direction, [0.0, 0.0, 1.0] if abs(direction[2]) < 0.9 else [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        plane = points @ np.column_stack([side, np.cross(direction, side)])
        cells = np.floor((plane - plane.min(axis=0)) / extent * _ACROSS).astype(np.int64)
        keys = cells[:, 0] * (4 * _ACROSS) + cells[:, 1]
        height = points @ direction
        nearest = np.full(int(keys.max()) + 1, -np.inf)
        np.maximum.at(nearest, keys, height)
        facing = normals @ direction
        # A cell of a slanted surface holds heights of its own size and more.
        slack = extent / _ACROSS * (0.5 + 1.0 / np.maximum(np.abs(facing), 0.2))
        seen = (height > nearest[keys] - slack) & (np.abs(facing) > 0.2)
        score += np.where(seen, facing, 0.0)
    return np.asarray(np.where(np.abs(score) > _CERTAIN, np.sign(score), 0.0))
