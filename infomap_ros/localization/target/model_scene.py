"""What a range map offers to the search for a model: thinned points with normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from infomap_ros.geometry.transforms import FloatArray
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
