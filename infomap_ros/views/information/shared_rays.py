"""Many orientations at one position share their rays.

From a position the sphere of directions is divided into cells (`views.sphere`). A ray is cast
through a cell when the first image looks there, and every other image that does reads its result.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, float_array
from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.views.information.entropy_reduction import expected_entropy_reduction
from infomap_ros.views.information.field import workers_of
from infomap_ros.views.information.gains import field_around, ray_arrays
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.ray_kernels import ray_bits, turned
from infomap_ros.views.information.rays import (
    camera_rays,
    checked_poses,
    checked_reach,
    checked_region,
)
from infomap_ros.views.information.view_query import ViewQuery


def information_of_views(
    m: VoxelMap,
    positions: ArrayLike,
    orientations: ArrayLike,
    camera: PinholeCamera,
    max_range: float,
    config: InformationConfig | None = None,
    region: ArrayLike | None = None,
    refine: int = 0,
    threads: int = 1,
) -> FloatArray:
    """What views from shared positions are expected to tell [bits].

    The same as `expected_information` with its default metric, within the sampling error of rays
    that are `shared_spacing` apart, for a fraction of the rays. Coarse before fine: the best views
    are then rated again with all their own rays.

    Args:
        m: the map.
        positions: of the camera, shape (P, 3), map frame [m].
        orientations: rotation part of T_map_camera, shape (O, 3, 3) for the same at every position,
            or (P, O, 3, 3).
        camera: its opening matters, its number of pixels does not.
        max_range: nothing farther is measured [m].
        config: rays and sensor.
        region: box (low, high), shape (2, 3), map frame [m]: only voxels in it count.
        refine: number of the best views, of all P x O, to be rated again with their own rays.
        threads: that share the positions.

    Returns:
        Shape (P, O).

    Raises:
        InvalidInputError: an argument has a wrong shape or impossible content.
    """
    settings = config or InformationConfig()
    places, rotations = _checked_views(positions, orientations)
    reach = checked_reach(places, max_range, m.config.voxel_size)
    bits = np.zeros(rotations.shape[:2])
    if bits.size == 0:
        return bits
    field = field_around(m, places, reach, settings, threads)
    arrays = ray_arrays(field, m, reach, settings)
    rays, angles = camera_rays(camera, 0.5 * settings.shared_spacing, settings.planar)
    middles = cell_middles(cells_per_edge(settings.shared_spacing))
    origins, box = field.relative(places), field.relative(checked_region(region))

    def cast(_: int, first: int, last: int) -> None:
        values = np.empty(6 * len(middles) ** 2, np.float32)
        part = origins[first:last], rotations[first:last]
        _share(*part, rays, angles, middles, box, arrays, values, bits[first:last])

    workers_of(threads).run(cast, len(places))
    _refine(m, places, rotations, camera, reach, settings, region, refine, threads, bits)
    return bits


def _checked_views(
    positions: ArrayLike, orientations: ArrayLike
) -> tuple[FloatArray, NDArray[np.float64]]:
    """Positions (P, 3) and rotations (P, O, 3, 3)."""
    places, rotations = float_array(positions, "positions"), float_array(orientations, "rotations")
    if places.ndim != 2 or places.shape[1] != 3:
        raise InvalidInputError("positions", f"shape {places.shape}, expected (P, 3)")
    if rotations.ndim == 3:
        rotations = np.broadcast_to(rotations, (len(places), *rotations.shape))
    if rotations.ndim != 4 or rotations.shape[0] != len(places) or rotations.shape[2:] != (3, 3):
        raise InvalidInputError(
            "orientations", f"shape {rotations.shape}, expected (O, 3, 3) or (P, O, 3, 3)"
        )
    checked_poses(_poses(places, rotations).reshape(-1, 4, 4))
    return places, np.ascontiguousarray(rotations)


def _poses(places: FloatArray, rotations: FloatArray) -> FloatArray:
    """T_map_camera of all views, shape (P, O, 4, 4)."""
    poses = np.zeros((*rotations.shape[:2], 4, 4))
    poses[..., :3, :3], poses[..., :3, 3], poses[..., 3, 3] = rotations, places[:, None], 1.0
    return poses


def _refine(
    m: VoxelMap,
    places: FloatArray,
    rotations: FloatArray,
    camera: PinholeCamera,
    max_range: float,
    config: InformationConfig,
    region: ArrayLike | None,
    count: int,
    threads: int,
    bits: FloatArray,
) -> None:
    """Rate the best `count` views again."""
    if count <= 0:
        return
    best = np.argsort(-bits, axis=None, kind="stable")[:count]
    at, of = np.unravel_index(best, bits.shape)
    poses = _poses(places[at], rotations[at, of][:, None])[:, 0]
    query = ViewQuery(m, poses, camera, max_range, config, region, threads)
    bits[at, of] = expected_entropy_reduction(query)


@kernel
def _share(
    origins: Any,
    rotations: Any,
    rays: Any,
    angles: Any,
    middles: Any,
    box: Any,
    arrays: Any,
    values: Any,
    bits: Any,
) -> None:
    """Bits of every view, shape (P, O); `values` is scratch for a number per cell."""
    low, high = (box[0, 0], box[0, 1], box[0, 2]), (box[1, 0], box[1, 1], box[1, 2])
    cells = len(middles)
    for place in range(len(origins)):
        origin = (origins[place, 0], origins[place, 1], origins[place, 2])
        values[:] = -1.0
        for view in range(rotations.shape[1]):
            total, rotation = 0.0, rotations[place, view]
            for ray in range(len(rays)):
                cell = cell_of(turned(rotation, rays[ray]), cells)
                if values[cell] < 0.0:
                    direction = cell_direction(cell, middles)
                    values[cell] = ray_bits(origin, direction, low, high, arrays)
                total += angles[ray] * values[cell]
            bits[place, view] = total


# A direction lies on the face that its largest component names; the other two, divided by it, are
# in [-1, 1] and are stretched by w(u) = u (1.2 - 0.2 u^2), which makes a cell at the middle of a
# face as wide, seen from the center, as one at its edge.

_STRETCH = 1.2


def cells_per_edge(spacing: float) -> int:
    """Cells along the edge of a face so that none is wider than `spacing` [rad].

    An odd number: level directions lie in the middle of a row of cells, and are cast level.
    """
    return math.ceil(2.0 / _STRETCH / spacing) // 2 * 2 + 1


def cell_middles(cells: int) -> FloatArray:
    """Coordinates u of the middles of `cells` cells along an edge, shape (cells,)."""
    w = (np.arange(cells) + 0.5) * (2.0 / cells) - 1.0
    u = w.copy()
    for _ in range(20):
        error = u * (_STRETCH - (_STRETCH - 1.0) * u * u) - w
        u -= error / (_STRETCH - 3.0 * (_STRETCH - 1.0) * u * u)
    return np.asarray(u)


@kernel
def _cell_along(u: float, cells: int) -> int:
    w = u * (_STRETCH - (_STRETCH - 1.0) * u * u)
    return min(int((w + 1.0) * 0.5 * cells), cells - 1)


@kernel
def cell_of(direction: Any, cells: int) -> int:
    """Cell in which a direction lies; there are ``6 cells^2``."""
    x, y, z = direction
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, scale, u, v = (0 if x > 0.0 else 1), 1.0 / ax, y, z
    elif ay >= az:
        face, scale, u, v = (2 if y > 0.0 else 3), 1.0 / ay, z, x
    else:
        face, scale, u, v = (4 if z > 0.0 else 5), 1.0 / az, x, y
    row = face * cells + _cell_along(u * scale, cells)
    return row * cells + _cell_along(v * scale, cells)


@kernel
def cell_direction(cell: int, middles: Any) -> tuple[float, float, float]:
    """Unit vector through the middle of a cell; `middles` as of `cell_middles`."""
    cells = len(middles)
    u, v = middles[cell // cells % cells], middles[cell % cells]
    face = cell // (cells * cells)
    length = 1.0 / math.sqrt(1.0 + u * u + v * v)
    side = length if face % 2 == 0 else -length
    u, v = u * length, v * length
    if face < 2:
        return side, u, v
    if face < 4:
        return v, side, u
    return u, v, side
