"""Which voxels of a block an organized scan sees through; the rule is in `free_space`."""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.scans.free_space import (
    FREE,
    HALF_DIAGONAL,
    NEAR,
    far_extent,
    to_camera,
)
from infomap_ros.mapping.scans.pyramid import level_for
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE

_ONE = np.uint64(1)
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
_CLOSE = 4.0
"""Blocks nearer than this many voxels choose the pyramid level voxel by voxel."""


@kernel
def footprint_level(view: Any, pyramid: Any, depth: float) -> int:
    """Level whose 3 x 3 neighborhoods hold the footprint of a voxel at this depth [m]."""
    return level_for(pyramid, HALF_DIAGONAL * view.size * max(view.fx, view.fy) / depth)


@kernel
def find_free_voxels(
    view: Any, pyramid: Any, blocks: Any, states: Any, first: int, last: int, bits: Any
) -> None:
    """Decide voxel by voxel which ones of the blocks [first, last) the scan sees through.

    Args:
        view: a `View`.
        pyramid: a `Pyramid`.
        blocks: block coordinates, shape (n, 3).
        states: FREE or MIXED, shape (n,).
        first: first block.
        last: one past the last block.
        bits: receives one bit per free voxel, uint64, shape (n, 8).
    """
    edge = BLOCK_SIDE * view.size
    extent = far_extent(view, 0.5 * view.size)
    reach = far_extent(view, 0.5 * (edge - view.size))
    for block in range(first, last):
        if states[block] == FREE:
            bits[block, :] = _ALL
            continue
        bits[block, :] = 0
        x, y, z = to_camera(
            view,
            (blocks[block, 0] + 0.5) * edge,
            (blocks[block, 1] + 0.5) * edge,
            (blocks[block, 2] + 0.5) * edge,
        )
        if z + reach <= NEAR:
            continue
        if z - reach < _CLOSE * view.size:
            _test_close_block(view, pyramid, x, y, z, extent, bits, block)
            continue
        level = footprint_level(view, pyramid, z - reach)
        decided = _test_block(view, pyramid, level, x, y, z, extent, reach)
        if decided == FREE:
            bits[block, :] = _ALL
        elif decided != 0:
            _test_voxels(view, pyramid, level, x, y, z, extent, bits, block)


@kernel
def _test_block(
    view: Any,
    pyramid: Any,
    level: int,
    x: float,
    y: float,
    z: float,
    extent: float,
    reach: float,
) -> int:
    """FREE when all voxels of the block are, 0 when none is, else -1.

    Args:
        view: a `View`.
        pyramid: a `Pyramid`.
        level: of the footprints.
        x: center of the block, camera coordinates [m], likewise y and z.
        y: see x.
        z: see x.
        extent: how far a voxel reaches beyond its center along the optical axis [m].
        reach: how far the voxels' centers reach beyond the block's [m].
    """
    u_low, u_high, v_low, v_high = np.inf, -np.inf, np.inf, -np.inf
    a, b, c, d, e, f, g, h, i = view.inverse_rotation
    half = 0.5 * (BLOCK_SIDE - 1) * view.size
    for corner in range(8):
        sx = half if corner & 1 else -half
        sy = half if corner & 2 else -half
        sz = half if corner & 4 else -half
        inverse = 1.0 / (z + g * sx + h * sy + i * sz)
        u = view.fx * (x + a * sx + b * sy + c * sz) * inverse + view.cx
        v = view.fy * (y + d * sx + e * sy + f * sz) * inverse + view.cy
        u_low, u_high = min(u_low, u), max(u_high, u)
        v_low, v_high = min(v_low, v), max(v_high, v)
    right, bottom = view.width - 0.5, view.height - 0.5
    if u_high < -0.5 or v_high < -0.5 or u_low >= right or v_low >= bottom:
        return 0
    inside = u_low >= -0.5 and v_low >= -0.5 and u_high < right and v_high < bottom
    shift = level + 1
    u0, u1 = int(max(u_low, 0.0) + 0.5) >> shift, int(min(u_high, right - 0.5) + 0.5) >> shift
    v0, v1 = int(max(v_low, 0.0) + 0.5) >> shift, int(min(v_high, bottom - 0.5) + 0.5) >> shift
    start, width = pyramid.starts[level], pyramid.widths[level]
    least, most = np.inf, -np.inf
    for row in range(v0, v1 + 1):
        for cell in range(start + row * width + u0, start + row * width + u1 + 1):
            value = pyramid.safe[cell]
            least, most = min(least, value), max(most, value)
    if most <= z - reach + extent:
        return 0
    if inside and least > z + reach + extent:
        return FREE
    return -1


@kernel
def _test_voxels(
    view: Any,
    pyramid: Any,
    level: int,
    x: float,
    y: float,
    z: float,
    extent: float,
    bits: Any,
    block: int,
) -> None:
    """Set the bits of the free voxels of a block with its center at camera (x, y, z)."""
    a, b, c, d, e, f, g, h, i = view.inverse_rotation
    size, fx, fy = view.size, view.fx, view.fy
    left, top = view.cx + 0.5, view.cy + 0.5
    width, height = view.width, view.height
    safe, start, cells = pyramid.safe, pyramid.starts[level], pyramid.widths[level]
    shift = level + 1
    first = np.uint64(start)
    for dz in range(BLOCK_SIDE):
        word = np.uint64(0)
        oz = (dz - 3.5) * size
        px, py, pz = x + c * oz, y + f * oz, z + i * oz
        for n in range(BLOCK_SIDE * BLOCK_SIDE):  # without a branch, for eight voxels at once
            ox, oy = ((n & 7) - 3.5) * size, ((n >> 3) - 3.5) * size
            depth = pz + h * oy + g * ox
            inverse = 1.0 / depth
            u = fx * (px + b * oy + a * ox) * inverse + left
            v = fy * (py + e * oy + d * ox) * inverse + top
            is_seen = (u >= 0.0) & (v >= 0.0) & (u < width) & (v < height)
            column, row = np.int64(u if is_seen else 0.0), np.int64(v if is_seen else 0.0)
            cell = (row >> shift) * cells + (column >> shift)
            is_free = is_seen & (safe[first + np.uint64(cell)] > depth + extent)
            word |= np.uint64(is_free) << np.uint64(n)
        bits[block, dz] = word


@kernel
def _test_close_block(
    view: Any, pyramid: Any, x: float, y: float, z: float, extent: float, bits: Any, block: int
) -> None:
    """Like `_test_voxels` for a block around or just before the camera."""
    a, b, c, d, e, f, g, h, i = view.inverse_rotation
    for dz in range(BLOCK_SIDE):
        word = np.uint64(0)
        for dy in range(BLOCK_SIDE):
            for dx in range(BLOCK_SIDE):
                ox, oy, oz = (
                    (dx - 3.5) * view.size,
                    (dy - 3.5) * view.size,
                    (dz - 3.5) * view.size,
                )
                depth = z + g * ox + h * oy + i * oz
                if depth <= NEAR:
                    continue
                u = view.fx * (x + a * ox + b * oy + c * oz) / depth + view.cx + 0.5
                v = view.fy * (y + d * ox + e * oy + f * oz) / depth + view.cy + 0.5
                if u >= 0.0 and v >= 0.0 and u < view.width and v < view.height:
                    level = footprint_level(view, pyramid, depth)
                    cell = (int(v) >> (level + 1)) * pyramid.widths[level] + (int(u) >> (level + 1))
                    if pyramid.safe[pyramid.starts[level] + cell] > depth + extent:
                        word |= _ONE << np.uint64(dy * BLOCK_SIDE + dx)
        bits[block, dz] = word
