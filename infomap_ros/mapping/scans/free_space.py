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
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.scans.association import rotated
from infomap_ros.mapping.scans.pyramid import all_see_past, level_for, most
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE

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
