"""Integrating one scan, as a few named steps.

gather     points by voxel, and the voxels through which the scan sees
observe    one observation per voxel, with the pose's error in it once
write      evidence and Gaussians into the map

Only the last step touches the map, and it runs after the last check.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.scans import scan, traversal
from infomap_ros.mapping.scans.association import Sensor
from infomap_ros.mapping.scans.image_gathering import ImageGatherer
from infomap_ros.mapping.scans.observation import observe_rows
from infomap_ros.mapping.scans.scan_input import GatheredScan, Scan, check_block_count
from infomap_ros.mapping.scans.workers import Workers
from infomap_ros.mapping.voxels.keys import unpack_all
from infomap_ros.mapping.voxels.storage import (
    FreeBlocks,
    MapStorage,
    Observations,
    ScanWriter,
    empty_observations,
)


@dataclass(frozen=True)
class IntegrationReport:
    """What became of the points of a scan.

    Attributes:
        points_used: points that informed the map.
        points_out_of_range: points beyond ``max_range``; they only free space.
        points_refused: points outside the coordinate limits or the camera's image, behind another
            point in their pixel, or with a covariance that is not positive.
        voxels_observed: voxels that received an observation.
        blocks_seen_through: blocks in which voxels were freed.
    """

    points_used: int
    points_out_of_range: int
    points_refused: int
    voxels_observed: int
    blocks_seen_through: int


class ScanIntegrator:
    """Integrates scans into a `MapStorage`; keeps threads and scratch memory."""

    def __init__(self, config: VoxelMapConfig) -> None:
        self._config = config
        self._workers = Workers(config.threads)
        self._clouds = CloudGatherer(config)
        self._images = ImageGatherer(config, self._workers)
        self._writer = ScanWriter(config, self._workers)

    def integrate(
        self, storage: MapStorage, measured: Scan, correlation: float
    ) -> IntegrationReport:
        """Add one scan to the map.

        Args:
            storage: the map's arrays.
            measured: the scan.
            correlation: of the errors of neighboring points, in [0, 1].

        Raises:
            CapacityError: the map would grow beyond its limit; nothing is changed.
        """
        sensor = self._sensor(measured)
        tallies = np.zeros(4, np.int64)
        found = self._gather(measured, sensor, tallies)
        observed = self._observe(found, measured, sensor, correlation)
        storage.check_capacity(observed, found.free, self._config.memory_limit * 1e9)
        self._writer.write(storage, observed, found.free, measured.transform)
        return IntegrationReport(
            points_used=int(tallies[0]),
            points_out_of_range=int(tallies[1]),
            points_refused=int(tallies[2] + tallies[3]) + measured.outside,
            voxels_observed=int(np.count_nonzero(observed.information[:, 0])),
            blocks_seen_through=len(found.free.bits),
        )

    def _gather(self, measured: Scan, sensor: Sensor, tallies: NDArray[np.int64]) -> GatheredScan:
        if measured.camera is None:
            return self._clouds.gather(measured, sensor, tallies)
        return self._images.gather(measured, measured.camera, sensor, tallies)

    def _sensor(self, measured: Scan) -> Sensor:
        config = self._config
        return Sensor(
            tuple(measured.transform[:3, :3].ravel().tolist()),
            tuple(measured.transform[:3, 3].tolist()),
            1.0 / config.voxel_size,
            config.voxel_size,
            config.max_range,
            config.association_sigmas,
            config.association_limit,
        )

    def _observe(
        self, found: GatheredScan, measured: Scan, sensor: Sensor, correlation: float
    ) -> Observations:
        """Observations of the voxels, and meanwhile the voxels through which the scan sees."""
        ends = np.cumsum([0, *(int(part.used[0]) for part in found.parts)]).tolist()
        observed = empty_observations(found.parts, ends, measured.clock)
        pose = np.stack([measured.pose_covariance, measured.drift])
        hit_quanta = self._config.hit_quanta

        def observe(part: int, first: int, last: int) -> None:
            rows = slice(ends[part], ends[part + 1])
            observe_rows(
                found.parts[part],
                sensor,
                pose,
                correlation,
                hit_quanta,
                first,
                last,
                observed.information[rows],
                observed.hits[rows],
                observed.sides[rows],
                observed.shares[rows],
            )

        parts = [(partial(observe, i), ends[i + 1] - ends[i]) for i in range(len(found.parts))]
        self._workers.share(*parts, (found.see, found.unseen))
        return observed


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
        coordinates = unpack_all(marks.keys[:count]).astype(np.int32)
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
        size = traversal.CELL_VOXELS * self._config.voxel_size
        while not traversal.gather_cells(cells, measured.points, size, self._config.max_range):
            cells = scan.empty_rows(2 * len(cells.keys))
        traversal.find_normals(cells)
        return cells
