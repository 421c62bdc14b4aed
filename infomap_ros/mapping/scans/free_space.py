"""Free space of an organized scan, by projecting voxels into the range image.

A voxel is free when most of its footprint is measured, and every measured pixel of it sees past the
voxel's far side. The rule asks the scan alone, so scans may come in any order; and a thin obstacle
that covers a few pixels of the footprint keeps its voxel, as does a floor seen at a grazing angle,
and a table top seen edge-on, of which no pixel may be measured.

A pyramid over the range image answers for whole footprints. The footprint of a voxel is a 3 x 3
neighborhood of cells on the level whose cells are as wide as half the footprint or wider; `safe`
holds the depth up to which every measured pixel of that neighborhood sees through. A cube of many
voxels is free where all cells of its footprint are measured and see past it, and holds nothing free
where none does. The cubes form an octree over the view frustum, down to blocks of 8 x 8 x 8 voxels;
`see_through` looks at those.

A pyramid over the range image that answers for whole footprints.

`lower` is the depth up to which every measured pixel of a cell sees through, `share` the part of
its area that is measured, `safe` the smallest `lower` of a cell and its neighbors (-inf where too
little of one is measured), `upper` what its farthest-seeing pixel reaches.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.scans.association import rotated
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE

LOW_CELL = 8
"""Parts of an image that begin at multiples of this [px] share no cell of the low levels."""

_LOW_LEVELS = 3
_MEASURED = 2.0 / 3.0  # share of a cell that must be measured for it to see through


class Pyramid(NamedTuple):
    """Depth pyramid; level l has cells of 2^(l + 1) pixels, all levels in flat arrays.

    Attributes:
        lower: depth up to which all measured pixels of a cell see through, float32 [m]; inf where
            none is measured.
        share: part of a cell's area that is measured, 0 to 1, float32.
        safe: smallest `lower` of a cell and its neighbors, float32 [m].
        upper: float32 [m].
        starts: first cell of each level, int64.
        widths: cells per row of each level, int64.
        heights: rows of cells of each level, int64.
    """

    lower: NDArray[np.float32]
    share: NDArray[np.float32]
    safe: NDArray[np.float32]
    upper: NDArray[np.float32]
    starts: NDArray[np.int64]
    widths: NDArray[np.int64]
    heights: NDArray[np.int64]


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


def ground_level(pyramid: Pyramid) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """`lower` and `upper` of the lowest level, by row and column of its cells."""
    shape = int(pyramid.heights[0]), int(pyramid.widths[0])
    cells = shape[0] * shape[1]
    return pyramid.lower[:cells].reshape(shape), pyramid.upper[:cells].reshape(shape)


@kernel
def build_low_levels(pyramid: Any, first: int, last: int) -> None:
    """Fill the levels whose cells are no wider than `LOW_CELL`, for some rows of the image.

    Those of the ground level have `lower` and `upper`. `safe` is left out in the cells beside other
    rows.

    Args:
        pyramid: a `Pyramid`.
        first: first row of the image [px], a multiple of `LOW_CELL`.
        last: one past the last row, a multiple of `LOW_CELL` or the height.
    """
    lower, share, width = pyramid.lower, pyramid.share, pyramid.widths[0]
    for i in range((first >> 1) * width, ((last + 1) >> 1) * width):
        share[i] = 1.0 if lower[i] < np.inf else 0.0
    for level in range(min(_LOW_LEVELS, len(pyramid.starts))):
        cell = 2 << level
        top, bottom = first // cell, (last + cell - 1) // cell
        if level > 0:
            _build_level(pyramid, level, top, bottom)
        is_end = bottom == pyramid.heights[level]
        _spread_level(pyramid, level, top + (top > 0), bottom - (0 if is_end else 1))


@kernel
def build_high_levels(pyramid: Any, cuts: Any) -> None:
    """Fill the other levels, and `safe` where it was left out.

    Args:
        pyramid: a `Pyramid`.
        cuts: rows of the image at which `build_low_levels` began, the first excepted.
    """
    for level in range(len(pyramid.starts)):
        if level >= _LOW_LEVELS:
            _build_level(pyramid, level, 0, pyramid.heights[level])
            _spread_level(pyramid, level, 0, pyramid.heights[level])
            continue
        for cut in cuts:
            row = cut // (2 << level)
            _spread_level(pyramid, level, max(row - 1, 0), min(row + 1, pyramid.heights[level]))


@kernel
def _build_level(pyramid: Any, level: int, first: int, last: int) -> None:
    """Fill the rows [first, last) of a level from the level below."""
    lower, share, upper = pyramid.lower, pyramid.share, pyramid.upper
    below, below_start = pyramid.widths[level - 1], pyramid.starts[level - 1]
    below_height, width = pyramid.heights[level - 1], pyramid.widths[level]
    for v in range(first, last):
        for u in range(width):
            low, high = np.inf, -np.inf
            parts, measured = 0, 0.0
            for dv in range(2):
                for du in range(2):
                    if 2 * v + dv < below_height and 2 * u + du < below:
                        i = below_start + (2 * v + dv) * below + 2 * u + du
                        parts += 1
                        measured += share[i]
                        low = min(low, lower[i])
                        high = max(high, upper[i])
            cell = pyramid.starts[level] + v * width + u
            lower[cell], share[cell] = low, measured / parts
            upper[cell] = high


@kernel
def _spread_level(pyramid: Any, level: int, first: int, last: int) -> None:
    """Fill `safe` from `lower` and `share` in the rows [first, last) of a level.

    Of a table top that is seen edge-on no pixel may be kept, as all are next to a jump of depth.
    What is measured beside the strip that is left out says nothing of the table top.
    """
    lower, share, safe = pyramid.lower, pyramid.share, pyramid.safe
    width, height = pyramid.widths[level], pyramid.heights[level]
    start = pyramid.starts[level]
    for v in range(first, last):
        above, below = max(v - 1, 0), min(v + 1, height - 1)
        columns_before, columns_here = np.inf, np.inf
        for u in range(width + 1):
            columns_next = np.inf
            if u < width:
                a, b, c = above * width + u, v * width + u, below * width + u
                columns_next = min(
                    _seen(lower, share, start + a),
                    min(_seen(lower, share, start + b), _seen(lower, share, start + c)),
                )
            if u > 0:
                safe[start + v * width + u - 1] = min(
                    columns_before, min(columns_here, columns_next)
                )
            columns_before, columns_here = columns_here, columns_next


@kernel
def _seen(lower: Any, share: Any, cell: int) -> Any:
    """Depth up to which a cell sees through, -inf where too little of it is measured."""
    return lower[cell] if share[cell] >= _MEASURED else np.float32(-np.inf)


@kernel
def level_for(pyramid: Any, extent: float) -> int:
    """Lowest level whose cells are at least `extent` pixels wide."""
    level, cell = 0, 2.0
    while cell < extent and level < len(pyramid.starts) - 1:
        level += 1
        cell *= 2.0
    return level


@kernel
def all_see_past(
    pyramid: Any, level: int, u0: int, v0: int, u1: int, v1: int, depth: float
) -> bool:
    """Whether all cells of the pixels [u0, u1] x [v0, v1] are measured and see past a depth [m]."""
    shift = level + 1
    for v in range(v0 >> shift, (v1 >> shift) + 1):
        start = pyramid.starts[level] + v * pyramid.widths[level]
        for u in range(u0 >> shift, (u1 >> shift) + 1):
            if pyramid.share[start + u] < 1.0 or pyramid.lower[start + u] <= depth:
                return False
    return True


@kernel
def most(values: Any, pyramid: Any, level: int, u0: int, v0: int, u1: int, v1: int) -> float:
    """Largest value of the cells that cover the pixels [u0, u1] x [v0, v1]."""
    largest = -np.inf
    shift = level + 1
    for v in range(v0 >> shift, (v1 >> shift) + 1):
        start = pyramid.starts[level] + v * pyramid.widths[level]
        for u in range(u0 >> shift, (u1 >> shift) + 1):
            largest = max(largest, values[start + u])
    return largest


FREE, MIXED = 1, 2
NEAR = 1e-3
HALF_DIAGONAL = 0.8660254037844386


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


@kernel
def to_camera(view: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Camera coordinates of a point of the map [m]."""
    t = view.position
    return rotated(view.inverse_rotation, x - t[0], y - t[1], z - t[2])


@kernel
def far_extent(view: Any, half: float) -> float:
    """How far a cube of half edge `half` reaches beyond its center along the optical axis."""
    r = view.inverse_rotation
    return half * (abs(r[6]) + abs(r[7]) + abs(r[8]))


@kernel
def _is_beside(view: Any, x: float, y: float, z: float, half: float) -> bool:
    """Whether a cube lies on the far side of a plane through the camera and an edge of the image.

    For cubes that reach behind the camera, which have no footprint.
    """
    left, top = view.cx + 0.5, view.cy + 0.5
    right, bottom = view.width - left, view.height - top
    return bool(
        _highest(view, view.fx, 0.0, left, x, y, z, half) < 0.0
        or _highest(view, -view.fx, 0.0, right, x, y, z, half) < 0.0
        or _highest(view, 0.0, view.fy, top, x, y, z, half) < 0.0
        or _highest(view, 0.0, -view.fy, bottom, x, y, z, half) < 0.0
    )


@kernel
def _highest(
    view: Any, a: float, b: float, c: float, x: float, y: float, z: float, half: float
) -> float:
    """Largest ``a x + b y + c z`` of the points of a cube, camera coordinates."""
    r = view.inverse_rotation
    spread = abs(a * r[0] + b * r[3] + c * r[6]) + abs(a * r[1] + b * r[4] + c * r[7])
    spread += abs(a * r[2] + b * r[5] + c * r[8])
    return a * x + b * y + c * z + half * spread


@kernel
def _classify(view: Any, pyramid: Any, x: float, y: float, z: float, half: float) -> int:
    """FREE, MIXED or 0 (nothing free) for the cube at camera coordinates, half edge `half` [m]."""
    reach = far_extent(view, half)
    near, far = z - reach, z + reach
    if far <= NEAR:
        return 0
    if near <= NEAR:
        return 0 if _is_beside(view, x, y, z, half) else MIXED
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
    # Wide enough to hold every neighborhood that a voxel of the cube may ask.
    spare = 4.0 * HALF_DIAGONAL * max(view.fx, view.fy) * view.size / near + 4.0
    u0 = int(min(max(u_low - spare, 0.0), view.width - 1.0))
    u1 = int(min(max(u_high + spare, 0.0), view.width - 1.0))
    v0 = int(min(max(v_low - spare, 0.0), view.height - 1.0))
    v1 = int(min(max(v_high + spare, 0.0), view.height - 1.0))
    level = max(0, level_for(pyramid, max(u1 - u0, v1 - v0) + 1.0) - 2)
    if most(pyramid.upper, pyramid, level, u0, v0, u1, v1) <= near:
        return 0
    if inside and all_see_past(pyramid, level, u0, v0, u1, v1, far):
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
    limit: int,
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
        limit: the search ends when more blocks than this are found.

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
                found = _descend(view, pyramid, stack, blocks, states, found, limit)
                if found > limit:
                    return found
    return found


@kernel
def _descend(
    view: Any, pyramid: Any, stack: Any, blocks: Any, states: Any, found: int, limit: int
) -> int:
    """Work off a stack of cubes (block coordinates, level); see `find_free_blocks`."""
    depth = 1
    edge = BLOCK_SIDE * view.size
    while depth > 0 and found <= limit:
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
