"""Gathering a scan with a camera: free space by projecting voxels into the range image.

Which voxels of a block an organized scan sees through; the rule is in `free_space`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera, invert_transform
from infomap_ros.geometry.kernel import inlined_kernel, kernel
from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.scans import free_space, scan
from infomap_ros.mapping.scans.association import NEAREST, Sensor
from infomap_ros.mapping.scans.free_space import (
    FREE,
    HALF_DIAGONAL,
    NEAR,
    far_extent,
    level_for,
    to_camera,
)
from infomap_ros.mapping.scans.organized import OrganizedScan, gather_organized
from infomap_ros.mapping.scans.plain_tiles import TILE, empty_groups
from infomap_ros.mapping.scans.scan_input import (
    FREE_BLOCK_BYTES,
    GatheredScan,
    Scan,
    check_block_count,
)
from infomap_ros.mapping.scans.workers import Workers
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, COORDINATE_LIMIT
from infomap_ros.mapping.voxels.storage import FreeBlocks

_TOP_LEVEL = 4


class ImageGatherer:
    """Scratch memory for gathering organized scans."""

    def __init__(self, config: VoxelMapConfig, workers: Workers) -> None:
        self._config = config
        self._workers = workers
        self._parts = [scan.empty_rows() for _ in range(workers.count)]
        self._groups = [empty_groups() for _ in range(workers.count)]
        self._pyramid = free_space.empty_pyramid(2, 2)
        self._image_size = (2, 2)
        self._blocks = np.empty((4096, 3), np.int32)

    def gather(
        self,
        measured: Scan,
        camera: PinholeCamera,
        sensor: Sensor,
        tallies: NDArray[np.int64],
    ) -> GatheredScan:
        """Gather one scan.

        Args:
            measured: the scan.
            camera: its camera.
            sensor: its sensor, for the kernels.
            tallies: receives the number of points taken, out of range, beyond the coordinate
                limit, and with a covariance that is not positive, shape (4,).

        Raises:
            CapacityError: the scan sees through more blocks than the memory limit allows.
        """
        image = self._image(measured, camera)
        rows = rows_of_parts(image, sensor, self._workers.count)
        part_tallies = np.zeros((self._workers.count, 4), np.int64)

        def gather(part: int) -> None:
            first, last = rows[part], rows[part + 1]
            self._gather_part(part, image, sensor, first, last, part_tallies[part])
            free_space.build_low_levels(self._pyramid, first, last)

        self._workers.together(*(partial(gather, part) for part in range(self._workers.count)))
        free_space.build_high_levels(self._pyramid, np.array(rows[1:-1], np.int64))
        self._separate_parts()
        tallies += part_tallies.sum(axis=0)
        return self._look(measured, camera)

    def _image(self, measured: Scan, camera: PinholeCamera) -> OrganizedScan:
        """The scan as the kernels take it, and the ground level of the pyramid."""
        if self._image_size != (camera.width, camera.height):
            self._pyramid = free_space.empty_pyramid(camera.width, camera.height)
            self._image_size = (camera.width, camera.height)
        lower, upper = free_space.ground_level(self._pyramid)
        return OrganizedScan(
            measured.points,
            measured.covariances,
            measured.columns,
            measured.pose_covariance,
            camera.fx,
            lower,
            upper,
        )

    def _gather_part(
        self,
        part: int,
        image: OrganizedScan,
        sensor: Sensor,
        first: int,
        last: int,
        tallies: NDArray[np.int64],
    ) -> None:
        """Gather the rows [first, last) of the image into a part, which grows as need be."""
        image.lower[first // 2 : (last + 1) // 2].fill(np.inf)
        image.upper[first // 2 : (last + 1) // 2].fill(-np.inf)
        while True:
            rows, groups = self._parts[part], self._groups[part]
            scan.clear_rows(rows)
            tallies[:] = 0
            if gather_organized(rows, sensor, image, first, last, tallies, groups):
                return
            self._parts[part] = scan.empty_rows(2 * len(rows.keys))

    def _look(self, measured: Scan, camera: PinholeCamera) -> GatheredScan:
        """Find the blocks that an organized scan sees through."""
        view = _view(measured, camera, self._config.voxel_size)
        states = self._find_blocks(view, measured, camera)
        free = FreeBlocks(self._blocks[: len(states)], np.empty((len(states), 8), np.uint64))

        def see(first: int, last: int) -> None:
            find_free_voxels(view, self._pyramid, free.coordinates, states, first, last, free.bits)

        return GatheredScan(self._parts, free, see, len(states))

    def _separate_parts(self) -> None:
        """Leave no voxel in two parts of the scan."""
        for last, source in enumerate(self._parts):
            for target in self._parts[:last]:
                scan.absorb_rows(source, target)

    def _find_blocks(
        self, view: free_space.View, measured: Scan, camera: PinholeCamera
    ) -> NDArray[np.uint8]:
        """List the blocks that may be free in part in `_blocks`; returns their states."""
        lowest, highest = _frustum_blocks(measured, camera, self._config)
        limit = int(self._config.memory_limit * 1e9 / FREE_BLOCK_BYTES)
        while True:
            states = np.empty(len(self._blocks), np.uint8)
            count = free_space.find_free_blocks(
                view, self._pyramid, lowest, highest, _TOP_LEVEL, self._blocks, states, limit
            )
            if count <= len(self._blocks):
                return states[:count]
            check_block_count(count, self._config)
            self._blocks = np.empty((count + count // 4, 3), np.int32)


def _view(measured: Scan, camera: PinholeCamera, voxel_size: float) -> free_space.View:
    inverse = invert_transform(measured.transform)
    return free_space.View(
        tuple(inverse[:3, :3].ravel().tolist()),
        tuple(measured.transform[:3, 3].tolist()),
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        camera.width,
        camera.height,
        voxel_size,
    )


def _frustum_blocks(
    measured: Scan, camera: PinholeCamera, config: VoxelMapConfig
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Smallest and largest block coordinates of the box around the view frustum."""
    u = np.array([-0.5, camera.width - 0.5])
    v = np.array([-0.5, camera.height - 0.5])
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    corners = np.array([[a, b, 1.0] for a in x for b in y]) * config.max_range
    corners = np.vstack([np.zeros(3), corners])
    world = corners @ measured.transform[:3, :3].T + measured.transform[:3, 3]
    edge = config.voxel_size * BLOCK_SIDE
    bound = COORDINATE_LIMIT // BLOCK_SIDE - 2
    lowest = np.floor(world.min(axis=0) / edge).clip(-bound, bound).astype(np.int64)
    highest = np.floor(world.max(axis=0) / edge).clip(-bound, bound).astype(np.int64)
    return lowest, highest


# Each thread gathers one part. One cut is shared by the fewest voxels, so it is better than many
# small strips in turn; where it lies follows from the scan alone, so the map does not depend on
# which thread is faster.

_STEP = 4
"""Of so many tiles of a strip, one is looked at."""

_APART, _MOST_VOXELS = 3, 24.0
"""A tile is measured over so many pixels, and taken for no larger than this [voxels]."""

_IN_RANGE, _VOXEL = 4.0, 0.15
"""Work on a tile in range, and on each voxel that it informs; out of range it is 1."""


def rows_of_parts(image: OrganizedScan, sensor: Sensor, parts: int) -> list[int]:
    """First row of each part, multiples of 8, and the height of the image at the end."""
    height = image.points.shape[0]
    if parts == 1:
        return [0, height]
    work = np.empty(-(-height // TILE))
    _estimate_work(sensor, image, work)
    done = np.cumsum(work)
    shares = done[-1] * np.arange(1, parts) / parts
    strips = np.searchsorted(done - 0.5 * work, shares)
    return [0, *(np.minimum(strips, len(work) - 1) * TILE).tolist(), height]


@kernel
def _estimate_work(sensor: Any, image: Any, work: Any) -> None:
    """Estimate the work on each strip of 8 rows from some of its pixels.

    Args:
        sensor: a `Sensor`.
        image: an `OrganizedScan`.
        work: receives the estimate, in units of a tile that is out of range, shape (strips,).
    """
    points, covariances, column = image.points, image.covariances, image.columns[5]
    height, width = points.shape[0], points.shape[1]
    stride = 0 if len(covariances) == 1 else 1
    for strip in range(len(work)):
        v = min(strip * TILE + TILE // 2, height - 1)
        total = 0.0
        for u in range((strip % _STEP) * TILE + TILE // 2, width, _STEP * TILE):
            total += 1.0
            x, y, z = points[v, u, 0], points[v, u, 1], points[v, u, 2]
            if z > NEAREST and x * x + y * y + z * z <= sensor.max_range**2:
                variance = covariances[stride * (v * width + u), column]
                reach = min(sensor.limit, sensor.sigmas * np.sqrt(variance) * sensor.inverse_size)
                along = _extent(points, v, u, 0, _APART) * sensor.inverse_size
                down = _extent(points, v, u, _APART, 0) * sensor.inverse_size
                total += _IN_RANGE + _VOXEL * _voxels(along) * _voxels(down) * (1.0 + 2.0 * reach)
        work[strip] = total


@inlined_kernel
def _extent(points: Any, v: int, u: int, dv: int, du: int) -> float:
    """Distance between two pixels, as it would be across a tile [m]; 0 where one is missing."""
    if v + dv >= points.shape[0] or u + du >= points.shape[1]:
        return 0.0
    dx = points[v + dv, u + du, 0] - points[v, u, 0]
    dy = points[v + dv, u + du, 1] - points[v, u, 1]
    dz = points[v + dv, u + du, 2] - points[v, u, 2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz) * (TILE / _APART)
    return distance if distance < np.inf else 0.0


@inlined_kernel
def _voxels(extent: float) -> float:
    """Voxels that an extent [voxels] crosses."""
    return 1.0 + min(extent, _MOST_VOXELS)


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
