"""Free space of an organised scan, by projecting voxels into the range image.

A voxel is free when every measured pixel of its footprint sees past the voxel's far side. The rule
asks the scan alone, so scans may come in any order; and a thin obstacle that covers a few pixels
of the footprint keeps its voxel, as does a floor seen at a grazing angle.

A pyramid over the range image answers for whole footprints. The footprint of a voxel is a 3 x 3
neighbourhood of cells on the level whose cells are as wide as half the footprint or wider; `safe`
holds the depth up to which every measured pixel of that neighbourhood sees through. For cubes of
many voxels, `strict` is the depth up to which all pixels of a cell see through if all its parts are
measured (else -inf), and `upper` what its farthest-seeing pixel reaches. The cubes form an octree
over the view frustum, down to blocks of 8 x 8 x 8 voxels; `see_through` looks at those.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.mapping.keys import BLOCK_SIDE
from infomap_ros.mapping.scan import rotated

FREE, MIXED = 1, 2
NEAR = 1e-3
HALF_DIAGONAL = 0.8660254037844386


class Pyramid(NamedTuple):
    """Depth pyramid; level l has cells of 2^(l + 1) pixels, all levels in flat arrays.

    Attributes:
        lower: depth up to which all measured pixels of a cell see through, float32 [m].
        safe: smallest `lower` of a cell and its neighbours, float32 [m].
        strict: float32 [m].
        upper: float32 [m].
        starts: first cell of each level, int64.
        widths: cells per row of each level, int64.
        heights: rows of cells of each level, int64.
    """

    lower: NDArray[np.float32]
    safe: NDArray[np.float32]
    strict: NDArray[np.float32]
    upper: NDArray[np.float32]
    starts: NDArray[np.int64]
    widths: NDArray[np.int64]
    heights: NDArray[np.int64]


class View(NamedTuple):
    """Camera and pose for the kernels.

    Attributes:
        inverse_rotation: R of T_sensor_map, row by row.
        position: sensor in the map [m].
        fx: [px], and likewise fy, cx, cy.
        width: [px].
        height: [px].
        size: voxel size [m].
    """

    inverse_rotation: tuple[float, ...]
    position: tuple[float, ...]
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    size: float


def empty_pyramid(width: int, height: int) -> Pyramid:
    """Storage for an image of this size [px]."""
    widths, heights = [(width + 1) // 2], [(height + 1) // 2]
    while max(widths[-1], heights[-1]) > 1:
        widths.append((widths[-1] + 1) // 2)
        heights.append((heights[-1] + 1) // 2)
    cells = np.array(widths) * np.array(heights)
    starts = np.concatenate([[0], np.cumsum(cells)[:-1]]).astype(np.int64)
    total = int(cells.sum())
    return Pyramid(
        np.empty(total, np.float32),
        np.empty(total, np.float32),
        np.empty(total, np.float32),
        np.empty(total, np.float32),
        starts,
        np.array(widths, np.int64),
        np.array(heights, np.int64),
    )


@njit(cache=True, nogil=True)
def build_pyramid(pyramid: Any) -> None:
    """Fill the levels above the ground level, whose `lower` and `upper` are given.

    A cell counts as measured in `lower` when at least half of its parts do.
    """
    lower, strict, upper = pyramid.lower, pyramid.strict, pyramid.upper
    ground = pyramid.widths[0] * pyramid.heights[0]
    for i in range(ground):
        if lower[i] == np.inf:
            lower[i] = -np.inf
        strict[i] = lower[i]
    for level in range(1, len(pyramid.starts)):
        width, height = pyramid.widths[level], pyramid.heights[level]
        below, below_start = pyramid.widths[level - 1], pyramid.starts[level - 1]
        below_height = pyramid.heights[level - 1]
        for v in range(height):
            for u in range(width):
                low, low_strict, high = np.inf, np.inf, -np.inf
                parts, measured = 0, 0
                for dv in range(2):
                    for du in range(2):
                        if 2 * v + dv < below_height and 2 * u + du < below:
                            i = below_start + (2 * v + dv) * below + 2 * u + du
                            parts += 1
                            if lower[i] > -np.inf:
                                measured += 1
                                low = min(low, lower[i])
                            low_strict = min(low_strict, strict[i])
                            high = max(high, upper[i])
                cell = pyramid.starts[level] + v * width + u
                lower[cell] = low if 2 * measured >= parts else -np.inf
                strict[cell] = low_strict
                upper[cell] = high


@njit(cache=True, nogil=True)
def spread_pyramid(pyramid: Any) -> None:
    """Fill `safe` from `lower`, on all levels."""
    lower, safe = pyramid.lower, pyramid.safe
    for level in range(len(pyramid.starts)):
        width, height = pyramid.widths[level], pyramid.heights[level]
        start = pyramid.starts[level]
        for v in range(height):
            above, below = max(v - 1, 0), min(v + 1, height - 1)
            columns_before, columns_here = np.inf, np.inf
            for u in range(width + 1):
                columns_next = np.inf
                if u < width:
                    a = lower[start + above * width + u]
                    b = lower[start + v * width + u]
                    c = lower[start + below * width + u]
                    columns_next = min(a, min(b, c))
                if u > 0:
                    safe[start + v * width + u - 1] = min(
                        columns_before, min(columns_here, columns_next)
                    )
                columns_before, columns_here = columns_here, columns_next


@njit(cache=True, nogil=True)
def level_for(pyramid: Any, extent: float) -> int:
    """Lowest level whose cells are at least `extent` pixels wide."""
    level, cell = 0, 2.0
    while cell < extent and level < len(pyramid.starts) - 1:
        level += 1
        cell *= 2.0
    return level


@njit(cache=True, nogil=True)
def _least(values: Any, pyramid: Any, level: int, u0: int, v0: int, u1: int, v1: int) -> float:
    """Smallest value of the cells that cover the pixels [u0, u1] x [v0, v1]."""
    least = np.inf
    shift = level + 1
    for v in range(v0 >> shift, (v1 >> shift) + 1):
        start = pyramid.starts[level] + v * pyramid.widths[level]
        for u in range(u0 >> shift, (u1 >> shift) + 1):
            least = min(least, values[start + u])
    return least


@njit(cache=True, nogil=True)
def _most(values: Any, pyramid: Any, level: int, u0: int, v0: int, u1: int, v1: int) -> float:
    """Largest value of the cells that cover the pixels [u0, u1] x [v0, v1]."""
    most = -np.inf
    shift = level + 1
    for v in range(v0 >> shift, (v1 >> shift) + 1):
        start = pyramid.starts[level] + v * pyramid.widths[level]
        for u in range(u0 >> shift, (u1 >> shift) + 1):
            most = max(most, values[start + u])
    return most


@njit(cache=True, nogil=True)
def to_camera(view: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Camera coordinates of a point of the map [m]."""
    t = view.position
    return rotated(view.inverse_rotation, x - t[0], y - t[1], z - t[2])


@njit(cache=True, nogil=True)
def far_extent(view: Any, half: float) -> float:
    """How far a cube of half edge `half` reaches beyond its centre along the optical axis."""
    r = view.inverse_rotation
    return half * (abs(r[6]) + abs(r[7]) + abs(r[8]))


@njit(cache=True, nogil=True)
def _classify(view: Any, pyramid: Any, x: float, y: float, z: float, half: float) -> int:
    """FREE, MIXED or 0 (nothing free) for the cube at camera coordinates, half edge `half` [m]."""
    reach = far_extent(view, half)
    near, far = z - reach, z + reach
    if far <= NEAR:
        return 0
    if near <= NEAR:
        return MIXED
    u_low, u_high, v_low, v_high = np.inf, -np.inf, np.inf, -np.inf
    for corner in range(8):
        sx = half if corner & 1 else -half
        sy = half if corner & 2 else -half
        sz = half if corner & 4 else -half
        ox, oy, oz = rotated(view.inverse_rotation, sx, sy, sz)
        u = view.fx * (x + ox) / (z + oz) + view.cx
        v = view.fy * (y + oy) / (z + oz) + view.cy
        u_low, u_high = min(u_low, u), max(u_high, u)
        v_low, v_high = min(v_low, v), max(v_high, v)
    if u_high < -0.5 or v_high < -0.5 or u_low > view.width - 0.5 or v_low > view.height - 0.5:
        return 0
    inside = (
        u_low >= -0.5 and v_low >= -0.5 and u_high < view.width - 0.5 and v_high < view.height - 0.5
    )
    # Wide enough to hold every neighbourhood that a voxel of the cube may ask.
    spare = 4.0 * HALF_DIAGONAL * max(view.fx, view.fy) * view.size / near + 4.0
    u0 = int(min(max(u_low - spare, 0.0), view.width - 1.0))
    u1 = int(min(max(u_high + spare, 0.0), view.width - 1.0))
    v0 = int(min(max(v_low - spare, 0.0), view.height - 1.0))
    v1 = int(min(max(v_high + spare, 0.0), view.height - 1.0))
    level = max(0, level_for(pyramid, max(u1 - u0, v1 - v0) + 1.0) - 2)
    if _most(pyramid.upper, pyramid, level, u0, v0, u1, v1) <= near:
        return 0
    if inside and _least(pyramid.strict, pyramid, level, u0, v0, u1, v1) > far:
        return FREE
    return MIXED


@njit(cache=True, nogil=True)
def find_free_blocks(
    view: Any,
    pyramid: Any,
    lowest: Any,
    highest: Any,
    top: int,
    blocks: Any,
    states: Any,
) -> int:
    """List the blocks in which the scan may free voxels.

    Args:
        view: a `View`.
        pyramid: a `Pyramid`.
        lowest: smallest block coordinates of the frustum's box, int64, shape (3,).
        highest: largest block coordinates, inclusive.
        top: the search starts with cubes of 2^top blocks.
        blocks: receives block coordinates, int32, shape (n, 3).
        states: receives FREE or MIXED, uint8, shape (n,).

    Returns:
        Number of blocks found; only the first n are stored.
    """
    stack = np.empty((64 * 8, 4), np.int64)
    found = 0
    side = 1 << top
    for bz in range((lowest[2] >> top) << top, highest[2] + 1, side):
        for by in range((lowest[1] >> top) << top, highest[1] + 1, side):
            for bx in range((lowest[0] >> top) << top, highest[0] + 1, side):
                stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = bx, by, bz, top
                found = _descend(view, pyramid, stack, blocks, states, found)
    return found


@njit(cache=True, nogil=True)
def _descend(view: Any, pyramid: Any, stack: Any, blocks: Any, states: Any, found: int) -> int:
    """Work off a stack of cubes (block coordinates, level); see `find_free_blocks`."""
    depth = 1
    edge = BLOCK_SIDE * view.size
    while depth > 0:
        depth -= 1
        bx, by, bz, level = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
        side = 1 << level
        half = 0.5 * side * edge
        x, y, z = to_camera(view, bx * edge + half, by * edge + half, bz * edge + half)
        state = _classify(view, pyramid, x, y, z, half)
        if state == 0:
            continue
        if state == FREE or level == 0:
            for dz in range(side):
                for dy in range(side):
                    for dx in range(side):
                        if found < len(states):
                            blocks[found, 0] = bx + dx
                            blocks[found, 1] = by + dy
                            blocks[found, 2] = bz + dz
                            states[found] = state
                        found += 1
        else:
            child = side >> 1
            for corner in range(8):
                stack[depth, 0] = bx + (child if corner & 1 else 0)
                stack[depth, 1] = by + (child if corner & 2 else 0)
                stack[depth, 2] = bz + (child if corner & 4 else 0)
                stack[depth, 3] = level - 1
                depth += 1
    return found
