"""Gathering a scan: its points by voxel, and the voxels that it sees through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.geometry import invert_transform
from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.scans import (
    association,
    cloud_normals,
    free_space,
    pyramid,
    scan,
    see_through,
    traversal,
)
from infomap_ros.mapping.scans.organised import gather_organised
from infomap_ros.mapping.scans.scan_input import Scan
from infomap_ros.mapping.scans.tiles import TILE, empty_groups
from infomap_ros.mapping.scans.workers import Workers
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, COORDINATE_LIMIT
from infomap_ros.mapping.voxels.storage import FreeBlocks

_TOP_LEVEL = 4
_FREE_BLOCK_BYTES = 64.0


class ScanGatherer:
    """Scratch memory for gathering scans."""

    def __init__(self, config: VoxelMapConfig, workers: Workers) -> None:
        self._config = config
        self._workers = workers
        self._parts = [scan.empty_rows() for _ in range(workers.count)]
        self._groups = [empty_groups() for _ in range(workers.count)]
        self._pyramid = pyramid.empty_pyramid(2, 2)
        self._image_size = (2, 2)
        self._blocks = np.empty((4096, 3), np.int32)

    def gather(
        self, measured: Scan, sensor: association.Sensor, tallies: NDArray[np.int64]
    ) -> tuple[list[scan.ScanRows], FreeBlocks]:
        """Gather one scan.

        Args:
            measured: the scan.
            sensor: its sensor, for the kernels.
            tallies: receives the number of points taken, out of range, beyond the coordinate
                limit, and with a covariance that is not positive, shape (4,).

        Returns:
            The points by voxel, in one or more parts that share no voxel with points and are valid
            until the next scan; and the blocks that it sees through.

        Raises:
            CapacityError: the scan sees through more blocks than the memory limit allows.
        """
        if measured.camera is None:
            return self._gather_cloud(measured, sensor, tallies)
        return self._gather_image(measured, sensor, tallies)

    def _gather_image(
        self, measured: Scan, sensor: association.Sensor, tallies: NDArray[np.int64]
    ) -> tuple[list[scan.ScanRows], FreeBlocks]:
        camera = measured.camera
        assert camera is not None
        if self._image_size != (camera.width, camera.height):
            self._pyramid = pyramid.empty_pyramid(camera.width, camera.height)
            self._image_size = (camera.width, camera.height)
        levels = self._pyramid
        shape = (int(levels.heights[0]), int(levels.widths[0]))
        ground = shape[0] * shape[1]
        lower = levels.lower[:ground].reshape(shape)
        upper = levels.upper[:ground].reshape(shape)
        lower.fill(np.inf)
        upper.fill(-np.inf)
        part_tallies = np.zeros((len(self._parts), 4), np.int64)

        def gather(part: int, first: int, last: int) -> bool:
            return gather_organised(
                self._parts[part],
                sensor,
                measured.pose_covariance,
                measured.points,
                measured.covariances,
                measured.columns,
                camera.fx,
                first,
                last,
                lower,
                upper,
                part_tallies[part],
                self._groups[part],
            )

        def gather_strips(part: int, strips: list[tuple[int, int]]) -> None:
            while True:
                scan.clear_rows(self._parts[part])
                part_tallies[part] = 0
                if all(gather(part, first, last) for first, last in strips):
                    return
                self._parts[part] = scan.empty_rows(2 * len(self._parts[part].keys))

        self._workers.deal(gather_strips, camera.height, TILE)
        pyramid.build_pyramid(levels)
        pyramid.spread_pyramid(levels)
        tallies += part_tallies.sum(axis=0)
        return self._parts, self._see(measured)

    def _separate_parts(self) -> None:
        """Leave no voxel in two parts of the scan."""
        for last, source in enumerate(self._parts):
            for target in self._parts[:last]:
                scan.absorb_rows(source, target)

    def _see(self, measured: Scan) -> FreeBlocks:
        """Blocks and voxels that an organised scan sees through; separates the parts meanwhile."""
        camera, config = measured.camera, self._config
        assert camera is not None
        inverse = invert_transform(measured.transform)
        view = free_space.View(
            tuple(inverse[:3, :3].ravel().tolist()),
            tuple(measured.transform[:3, 3].tolist()),
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            camera.width,
            camera.height,
            config.voxel_size,
        )
        found: list[NDArray[np.uint8]] = []
        self._workers.together(
            lambda: found.append(self._find_blocks(view, measured)), self._separate_parts
        )
        states = found[0]
        count = len(states)
        bits = np.empty((count, 8), np.uint64)

        def see(_: int, first: int, last: int) -> None:
            see_through.find_free_voxels(
                view, self._pyramid, self._blocks, states, first, last, bits
            )

        self._workers.run(see, count)
        return FreeBlocks(self._blocks[:count], bits)

    def _find_blocks(self, view: free_space.View, measured: Scan) -> NDArray[np.uint8]:
        """List the blocks that may be free in part in `_blocks`; returns their states."""
        lowest, highest = _frustum_blocks(measured, self._config)
        limit = int(self._config.memory_limit * 1e9 / _FREE_BLOCK_BYTES)
        while True:
            states = np.empty(len(self._blocks), np.uint8)
            count = free_space.find_free_blocks(
                view, self._pyramid, lowest, highest, _TOP_LEVEL, self._blocks, states, limit
            )
            if count <= len(self._blocks):
                return states[:count]
            self._check_block_count(count)
            self._blocks = np.empty((count + count // 4, 3), np.int32)

    def _cloud_cells(self, measured: Scan) -> scan.ScanRows:
        """Normals of an unorganised scan."""
        cells = scan.empty_rows()
        size = cloud_normals.CELL_VOXELS * self._config.voxel_size
        while not cloud_normals.gather_cells(cells, measured.points, size, self._config.max_range):
            cells = scan.empty_rows(2 * len(cells.keys))
        cloud_normals.find_normals(cells)
        return cells

    def _gather_cloud(
        self, measured: Scan, sensor: association.Sensor, tallies: NDArray[np.int64]
    ) -> tuple[list[scan.ScanRows], FreeBlocks]:
        far, cells = scan.empty_rows(), self._cloud_cells(measured)
        while True:
            tallies[:] = 0
            scan.clear_rows(self._parts[0])
            scan.clear_rows(far)
            if traversal.gather_cloud(
                self._parts[0],
                far,
                cells,
                sensor,
                measured.pose_covariance,
                measured.points,
                measured.covariances,
                measured.columns,
                tallies,
            ):
                break
            self._parts[0] = scan.empty_rows(2 * len(self._parts[0].keys))
            far = scan.empty_rows(2 * len(far.keys))
        marks, gap = traversal.empty_marks(), self._config.free_gap
        while not traversal.mark_free(marks, self._parts[0], far, sensor, gap):
            self._check_block_count(2 * len(marks.keys))
            marks = traversal.empty_marks(2 * len(marks.keys))
        count = int(marks.used[0])
        coordinates = np.empty((count, 3), np.int32)
        traversal.unpack_all(marks.keys, count, coordinates)
        return self._parts[:1], FreeBlocks(coordinates, marks.bits[:count])

    def _check_block_count(self, count: int) -> None:
        """Refuse a scan that alone would fill the memory limit."""
        limit = self._config.memory_limit * 1e9
        if count * _FREE_BLOCK_BYTES > limit:
            raise CapacityError(
                f"one scan sees through {count} blocks or more of {BLOCK_SIDE}^3 voxels, too "
                f"many for the memory limit of {self._config.memory_limit:g} GB: reduce max_range "
                "or enlarge voxel_size"
            )


def _frustum_blocks(
    measured: Scan, config: VoxelMapConfig
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Smallest and largest block coordinates of the box around the view frustum."""
    camera = measured.camera
    assert camera is not None
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
