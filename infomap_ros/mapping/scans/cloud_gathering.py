"""Gathering a scan without a camera: free space by traversing its rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.scans import cloud_normals, scan, traversal
from infomap_ros.mapping.scans.association import Sensor
from infomap_ros.mapping.scans.gathered_scan import GatheredScan, check_block_count
from infomap_ros.mapping.scans.scan_input import Scan
from infomap_ros.mapping.voxels.storage import FreeBlocks


class CloudGatherer:
    """Scratch memory for gathering unorganized scans."""

    def __init__(self, config: VoxelMapConfig) -> None:
        self._config = config
        self._rows = scan.empty_rows()

    def gather(self, measured: Scan, sensor: Sensor, tallies: NDArray[np.int64]) -> GatheredScan:
        """Gather one scan; see `infomap_ros.mapping.scans.image_gathering`.

        Raises:
            CapacityError: the scan sees through more blocks than the memory limit allows.
        """
        far = self._gather_points(measured, sensor, tallies)
        marks, gap = traversal.empty_marks(), self._config.free_gap
        while not traversal.mark_free(marks, self._rows, far, sensor, gap):
            check_block_count(2 * len(marks.keys), self._config)
            marks = traversal.empty_marks(2 * len(marks.keys))
        count = int(marks.used[0])
        coordinates = np.empty((count, 3), np.int32)
        traversal.unpack_all(marks.keys, count, coordinates)
        free = FreeBlocks(coordinates, marks.bits[:count])
        return GatheredScan([self._rows], free, lambda first, last: None, 0)

    def _gather_points(
        self, measured: Scan, sensor: Sensor, tallies: NDArray[np.int64]
    ) -> scan.ScanRows:
        """Gather the points by voxel; returns those out of range, likewise."""
        far, cells = scan.empty_rows(), self._cells(measured)
        while True:
            tallies[:] = 0
            scan.clear_rows(self._rows)
            scan.clear_rows(far)
            if traversal.gather_cloud(
                self._rows,
                far,
                cells,
                sensor,
                measured.pose_covariance,
                measured.points,
                measured.covariances,
                measured.columns,
                tallies,
            ):
                return far
            self._rows = scan.empty_rows(2 * len(self._rows.keys))
            far = scan.empty_rows(2 * len(far.keys))

    def _cells(self, measured: Scan) -> scan.ScanRows:
        """Normals of an unorganized scan."""
        cells = scan.empty_rows()
        size = cloud_normals.CELL_VOXELS * self._config.voxel_size
        while not cloud_normals.gather_cells(cells, measured.points, size, self._config.max_range):
            cells = scan.empty_rows(2 * len(cells.keys))
        cloud_normals.find_normals(cells)
        return cells
