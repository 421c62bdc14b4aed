"""Covering solids by spheres: the whole solid is in them, and they stick out by a bounded length.

A sphere about a point at depth d inside the solid may have the radius d + tolerance, as it then
stays within the solid grown by the tolerance. The solid is cut into cells, small ones near its
surface and larger ones in its depth, so that the sphere about each cell's own center would hold the
cell. Of these spheres, and those of the larger cells that were cut, enough are chosen that each
cell is wholly in one, greedily the sphere that holds most cells not yet held (set cover); each is
then shrunk to what it must hold.
"""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
from numba import njit

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PlacedSolid, Solid, Sphere
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.solid_extent import solid_extent

_CELLS = 4000
_GROWTH = 1.25
_SHARE = 0.5  # a cell's half diagonal in radii of the sphere about its center
_SLACK = 1e-7  # [m]; for what the extent of a polytope and rounding leave open


def cover_by_spheres(solid: Solid, tolerance: float) -> FloatArray:
    """Spheres whose union holds a solid.

    Args:
        solid: a convex body.
        tolerance: how far the spheres may stick out of the solid [m]. A solid that would need too
            many cells for this is covered with the least larger tolerance that needs fewer.

    Returns:
        Centers in the solid's frame and radii, shape (K, 4) [m].

    Raises:
        InvalidInputError: the tolerance is not positive.
    """
    if not tolerance > 0.0:
        raise InvalidInputError("tolerance", f"is {tolerance}, expected more than 0 m")
    if isinstance(solid, Sphere):
        return np.array([[0.0, 0.0, 0.0, solid.radius]])
    extent = solid_extent(PlacedSolid(solid, np.eye(4)))
    while True:
        cut = _cut(solid, extent, tolerance)
        if cut is not None:
            return np.asarray(_chosen(*cut))
        tolerance *= _GROWTH


def _cut(
    solid: Solid, extent: tuple[FloatArray, FloatArray], tolerance: float
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Cells (center and half diagonal, shape (N, 4)), and centers (M, 3) and radii (M,) of spheres.

    None where there are too many cells.
    """
    low, high = extent
    size = np.maximum(high - low, 1e-3 * tolerance) + _SLACK
    counts = np.maximum(np.round(size / max(size.min(), tolerance)), 1).astype(int)
    axes = [a + w * (np.arange(n) + 0.5) / n for a, w, n in zip(low, size, counts, strict=True)]
    centers = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    edges, cells, candidates, radii = size / counts, [], [], []
    while len(centers):
        half = 0.5 * float(np.linalg.norm(edges)) + _SLACK
        allowed = tolerance - solid.signed_distance(centers)
        centers, allowed = (
            centers[allowed >= tolerance - half],
            allowed[allowed >= tolerance - half],
        )
        candidates.append(centers[allowed > 0.0])
        radii.append(allowed[allowed > 0.0])
        done = half <= _SHARE * allowed
        cells.append(np.column_stack([centers[done], np.full(np.count_nonzero(done), half)]))
        if sum(map(len, cells)) + np.count_nonzero(~done) > _CELLS:
            return None
        centers, edges = _halved(centers[~done], edges)
    return np.concatenate(cells), np.concatenate(candidates), np.concatenate(radii)


def _halved(centers: FloatArray, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cut boxes in half along their long axes; new centers, shape (N, 3), and edges, (3,)."""
    long = edges > 0.6 * edges.max()
    edges = np.where(long, 0.5 * edges, edges)
    signs = [(-0.5, 0.5) if is_long else (0.0,) for is_long in long]
    offsets = np.array(list(product(*signs))) * edges
    return (centers[:, None] + offsets).reshape(-1, 3), edges


@njit(cache=True, nogil=True)
def _chosen(cells: Any, centers: Any, radii: Any) -> Any:
    """Greedy set cover of the cells, shape (N, 4), by spheres, (M, 3) and (M,); shape (K, 4).

    Of spheres that hold equally many cells, the smallest is taken.
    """
    count, left = len(cells), len(cells)
    held, gains = np.zeros(count, np.bool_), np.zeros(len(radii), np.int64)
    for m in range(len(radii)):
        for n in range(count):
            gains[m] += _radius_to_hold(centers[m], cells[n]) <= radii[m] + _SLACK
    spheres = np.empty((count, 4))
    chosen = 0
    while left > 0:
        best = 0
        for m in range(1, len(radii)):
            if gains[m] > gains[best] or (gains[m] == gains[best] and radii[m] < radii[best]):
                best = m
        spheres[chosen, :3], spheres[chosen, 3] = centers[best], 0.0
        for n in range(count):
            needed = _radius_to_hold(centers[best], cells[n])
            if held[n] or needed > radii[best] + _SLACK:
                continue
            held[n] = True
            left -= 1
            spheres[chosen, 3] = max(spheres[chosen, 3], needed)
            for m in range(len(radii)):
                gains[m] -= _radius_to_hold(centers[m], cells[n]) <= radii[m] + _SLACK
        chosen += 1
    return spheres[:chosen].copy()


@njit(cache=True, nogil=True, inline="always")
def _radius_to_hold(center: Any, cell: Any) -> float:
    x, y, z = center[0] - cell[0], center[1] - cell[1], center[2] - cell[2]
    return math.sqrt(x * x + y * y + z * z) + cell[3]
