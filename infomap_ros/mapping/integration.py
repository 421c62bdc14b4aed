"""Integrating one scan, as a few named steps.

gather     points by voxel, free depths by pixel
observe    one observation per voxel, with the pose's error in it once
see        the voxels through which the scan sees
write      evidence and Gaussians into the map

Only the last step touches the map, and it runs after the last check.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.geometry import invert_transform
from infomap_ros.mapping import cloud_normals, free_space, scan, see_through, traversal, update
from infomap_ros.mapping.blocks import (
    BlockArrays,
    block_bytes,
    empty_blocks,
    grown,
    with_room,
)
from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.gaussians import (
    GaussianArrays,
    empty_gaussians,
    gaussian_bytes,
    with_gaussian_room,
    with_table_room,
)
from infomap_ros.mapping.keys import BLOCK_SIDE, BLOCK_VOXELS, COORDINATE_LIMIT
from infomap_ros.mapping.observation import empty_observations, observe_rows
from infomap_ros.mapping.organised import TILE, gather_organised
from infomap_ros.mapping.scan_input import Scan

_TOP_LEVEL = 4


@dataclass(frozen=True)
class IntegrationReport:
    """What became of the points of a scan.

    Attributes:
        points_used: points that informed the map.
        points_out_of_range: points beyond ``max_range``; they only free space.
        points_refused: points outside the coordinate limits or the camera's image, or with a
            covariance that is not positive.
        voxels_observed: voxels that received an observation.
        blocks_seen_through: blocks in which voxels were freed.
    """

    points_used: int
    points_out_of_range: int
    points_refused: int
    voxels_observed: int
    blocks_seen_through: int


@dataclass
class MapStorage:
    """The map's arrays; replaced by larger ones as the map grows."""

    blocks: BlockArrays = field(default_factory=empty_blocks)
    gaussians: GaussianArrays = field(default_factory=empty_gaussians)

    def memory_bytes(self) -> int:
        """Memory in use [bytes]."""
        return block_bytes(self.blocks) + gaussian_bytes(self.gaussians)


@dataclass(frozen=True, eq=False)
class FreeBlocks:
    """Blocks with voxels that a scan sees through.

    Attributes:
        coordinates: block coordinates, shape (n, 3), int32.
        bits: one bit per free voxel, shape (n, 8), uint64.
    """

    coordinates: NDArray[np.int32]
    bits: NDArray[np.uint64]


class ScanIntegrator:
    """Scratch memory and threads for integrating scans into a `MapStorage`."""

    def __init__(self, config: VoxelMapConfig) -> None:
        self._config = config
        self._parts = [scan.empty_rows() for _ in range(config.threads)]
        self._pool = ThreadPoolExecutor(config.threads) if config.threads > 1 else None
        self._pyramid = free_space.empty_pyramid(2, 2)
        self._image_size = (2, 2)
        self._blocks = np.empty((4096, 3), np.int32)
        self._hit_row = np.full(0, -1, np.int32)

    def integrate(
        self, storage: MapStorage, measured: Scan, correlation: float
    ) -> IntegrationReport:
        """Add one scan to the map.

        Args:
            storage: the map's arrays.
            measured: the scan.
            correlation: of the errors of neighbouring points, in [0, 1].

        Raises:
            CapacityError: the map would grow beyond its limit; nothing is changed.
        """
        sensor = self._sensor(measured)
        tallies = np.zeros(4, np.int64)
        if measured.camera is None:
            rows, free = self._gather_cloud(measured, sensor, tallies)
        else:
            rows, free = self._gather_image(measured, sensor, tallies)
        information, hits, refused = self._observe(rows, measured, sensor, correlation)
        self._check_capacity(storage, int(rows.used[0]), len(free.coordinates))
        self._write(storage, rows, information, hits, free)
        return IntegrationReport(
            points_used=int(tallies[0]),
            points_out_of_range=int(tallies[1]),
            points_refused=int(tallies[2] + tallies[3]) + measured.outside,
            voxels_observed=int(rows.used[0]) - refused,
            blocks_seen_through=len(free.coordinates),
        )

    def _sensor(self, measured: Scan) -> scan.Sensor:
        config = self._config
        return scan.Sensor(
            tuple(measured.transform[:3, :3].ravel().tolist()),
            tuple(measured.transform[:3, 3].tolist()),
            1.0 / config.voxel_size,
            config.voxel_size,
            config.max_range,
            config.association_sigmas,
            config.association_limit,
        )

    def _in_parallel(self, task: Callable[[int, int, int], Any], count: int, unit: int) -> None:
        """Run task(part, first, last) over [0, count), cut at multiples of `unit`."""
        if self._pool is None or count < 2 * unit:
            task(0, 0, count)
            return
        parts = self._config.threads
        cuts = [min(count, math.ceil(count * i / parts / unit) * unit) for i in range(parts + 1)]
        list(self._pool.map(task, range(parts), cuts[:-1], cuts[1:]))

    def _gather_image(
        self, measured: Scan, sensor: scan.Sensor, tallies: NDArray[np.int64]
    ) -> tuple[scan.ScanRows, FreeBlocks]:
        camera = measured.camera
        assert camera is not None
        if self._image_size != (camera.width, camera.height):
            self._pyramid = free_space.empty_pyramid(camera.width, camera.height)
            self._image_size = (camera.width, camera.height)
        pyramid = self._pyramid
        shape = (int(pyramid.heights[0]), int(pyramid.widths[0]))
        ground = shape[0] * shape[1]
        lower = pyramid.lower[:ground].reshape(shape)
        upper = pyramid.upper[:ground].reshape(shape)
        part_tallies = np.zeros((len(self._parts), 4), np.int64)

        def gather(part: int, first: int, last: int) -> None:
            while True:
                scan.clear_rows(self._parts[part])
                part_tallies[part] = 0
                if gather_organised(
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
                ):
                    return
                self._parts[part] = scan.empty_rows(2 * len(self._parts[part].keys))

        for part in self._parts:
            scan.clear_rows(part)
        self._in_parallel(gather, camera.height, TILE)
        free_space.build_pyramid(pyramid)
        free_space.spread_pyramid(pyramid)
        tallies += part_tallies.sum(axis=0)
        return self._merged_rows(), self._see(measured)

    def _merged_rows(self) -> scan.ScanRows:
        """Rows of all parts in the first part's storage."""
        for source in self._parts[1:]:
            needed = int(self._parts[0].used[0] + source.used[0])
            if needed > len(self._parts[0].keys):
                larger = scan.empty_rows(2 * needed)
                scan.merge_rows(self._parts[0], larger)
                self._parts[0] = larger
            scan.merge_rows(source, self._parts[0])
        return self._parts[0]

    def _see(self, measured: Scan) -> FreeBlocks:
        """Blocks and voxels that an organised scan sees through."""
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
        lowest, highest = _frustum_blocks(measured, config)
        while True:
            states = np.empty(len(self._blocks), np.uint8)
            count = free_space.find_free_blocks(
                view, self._pyramid, lowest, highest, _TOP_LEVEL, self._blocks, states
            )
            if count <= len(self._blocks):
                break
            self._check_block_count(count)
            self._blocks = np.empty((count + count // 4, 3), np.int32)
        bits = np.empty((count, 8), np.uint64)

        def see(_: int, first: int, last: int) -> None:
            see_through.find_free_voxels(
                view, self._pyramid, self._blocks, states, first, last, bits
            )

        self._in_parallel(see, count, 1)
        return FreeBlocks(self._blocks[:count], bits)

    def _cloud_cells(self, measured: Scan) -> scan.ScanRows:
        """Normals of an unorganised scan."""
        cells = scan.empty_rows()
        size = cloud_normals.CELL_VOXELS * self._config.voxel_size
        while not cloud_normals.gather_cells(cells, measured.points, size, self._config.max_range):
            cells = scan.empty_rows(2 * len(cells.keys))
        cloud_normals.find_normals(cells)
        return cells

    def _gather_cloud(
        self, measured: Scan, sensor: scan.Sensor, tallies: NDArray[np.int64]
    ) -> tuple[scan.ScanRows, FreeBlocks]:
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
        marks = traversal.empty_marks()
        while not traversal.mark_free(marks, self._parts[0], far, sensor):
            self._check_block_count(2 * len(marks.keys))
            marks = traversal.empty_marks(2 * len(marks.keys))
        count = int(marks.used[0])
        coordinates = np.empty((count, 3), np.int32)
        traversal.unpack_all(marks.keys, count, coordinates)
        return self._parts[0], FreeBlocks(coordinates, marks.bits[:count])

    def _observe(
        self, rows: scan.ScanRows, measured: Scan, sensor: scan.Sensor, correlation: float
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], int]:
        count = int(rows.used[0])
        information, hits = empty_observations(count)
        refused = np.zeros(len(self._parts), np.int64)
        hit_quanta = self._config.hit_quanta

        def observe(part: int, first: int, last: int) -> None:
            refused[part] = observe_rows(
                rows,
                sensor,
                measured.pose_covariance,
                correlation,
                hit_quanta,
                first,
                last,
                information,
                hits,
            )

        self._in_parallel(observe, count, 1)
        return information, hits, int(refused.sum())

    def _check_block_count(self, count: int) -> None:
        """Refuse a scan that alone would fill the memory limit."""
        limit = self._config.memory_limit * 1e9
        if count * 64.0 > limit:
            raise CapacityError(
                f"one scan sees through {count} blocks of {BLOCK_SIDE}^3 voxels, too many for the "
                f"memory limit of {self._config.memory_limit:g} GB: reduce max_range or enlarge "
                "voxel_size"
            )

    def _check_capacity(self, storage: MapStorage, rows: int, free: int) -> None:
        limit = self._config.memory_limit * 1e9
        needed = storage.memory_bytes() + free * 64 + rows * 48
        if needed > limit:
            raise CapacityError(
                f"the map holds {storage.memory_bytes() / 1e9:.3g} GB and this scan could bring it "
                f"to {needed / 1e9:.3g} GB, above the limit of {self._config.memory_limit:g} GB"
            )

    def _write(
        self,
        storage: MapStorage,
        rows: scan.ScanRows,
        information: NDArray[np.float32],
        hits: NDArray[np.int32],
        free: FreeBlocks,
    ) -> None:
        config, count = self._config, len(information)
        blocks = with_room(storage.blocks, count + len(free.bits), count + len(free.bits))
        gaussians = with_gaussian_room(storage.gaussians, count, len(blocks.keys))
        if len(self._hit_row) < len(blocks.keys):
            self._hit_row = grown(self._hit_row, len(blocks.keys), -1)
        owners = np.empty(count, np.int64)
        hit_bits = np.zeros((count, 8), np.uint64)
        miss = config.miss_quanta
        update.enter_rows(
            blocks, rows, hits, self._hit_row, hit_bits, owners, -miss, config.hit_quanta
        )
        merged = 0
        while merged < count:
            gaussians = with_table_room(gaussians)
            merged = update.merge_rows_into_map(
                blocks, gaussians, owners, information, merged, count
            )
        update.free_voxels(
            blocks, free.coordinates, free.bits, len(free.bits), self._hit_row, hit_bits, miss
        )
        self._hit_row[owners // BLOCK_VOXELS] = -1
        storage.blocks, storage.gaussians = blocks, gaussians


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
