"""A map that follows the poses of its scans as they are corrected."""

from __future__ import annotations

from numpy.typing import ArrayLike

from infomap_ros.geometry import PinholeCamera, check_transform
from infomap_ros.mapping.correction.pose_corrections import PoseCorrections
from infomap_ros.mapping.correction.reintegration import (
    Reintegration,
    ReintegrationConfig,
    ReintegrationReport,
    moved_scans,
)
from infomap_ros.mapping.correction.scan_store import ScanStore, ScanStoreConfig
from infomap_ros.mapping.scans.integration import IntegrationReport
from infomap_ros.mapping.voxel_map import VoxelMap


class CorrectableMap:
    """Integrates scans, hears of corrected poses, and corrects the map a little at a time.

    Args:
        voxel_map: what it holds already stays where it is.
        store: how many scans are kept.
        config: when they follow.

    Attributes:
        voxel_map: the map.
        store: its scans.
    """

    def __init__(
        self,
        voxel_map: VoxelMap,
        store: ScanStoreConfig | None = None,
        config: ReintegrationConfig | None = None,
    ) -> None:
        self.voxel_map = voxel_map
        kept = store or ScanStoreConfig()
        base = voxel_map if kept.memory and voxel_map.known_voxels else None
        self.store = ScanStore(voxel_map.config, kept, base)
        self._config = config or ReintegrationConfig()
        self._corrections = PoseCorrections()
        self._work: Reintegration | None = None

    @property
    def is_correcting(self) -> bool:
        """Whether a correction has begun and is not finished."""
        return self._work is not None

    def memory_bytes(self) -> int:
        """Memory in use by the map and its scans [bytes]; the work on a correction not counted."""
        return self.voxel_map.memory_bytes() + self.store.memory_bytes()

    def integrate(
        self,
        stamp: int,
        points: ArrayLike,
        T_map_sensor: ArrayLike,
        covariances: ArrayLike | None = None,
        pose_covariance: ArrayLike | None = None,
        camera: PinholeCamera | None = None,
        error_correlation: float | None = None,
    ) -> IntegrationReport:
        """Add a scan as `VoxelMap.integrate` does.

        Raises:
            InvalidInputError: as there.
            CapacityError: as there.
        """
        arguments = (points, T_map_sensor, covariances, pose_covariance, camera, error_correlation)
        report = self.store.integrate(self.voxel_map, stamp, *arguments)
        if self.store.config.memory:
            self._corrections.add(stamp, check_transform(T_map_sensor))
        self._freeze()
        return report

    def hear(self, as_of: int, stamps: ArrayLike, transforms: ArrayLike) -> None:
        """Hear of corrected poses; see `PoseCorrections.hear`.

        Raises:
            InvalidInputError: a pose is none, or the stamps do not fit.
        """
        self._corrections.hear(as_of, stamps, transforms)

    def begin_correction(self) -> bool:
        """Begin to correct the map where scans belong elsewhere by now; whether there are any."""
        if self._work is None:
            poses = self._corrections.poses
            moved = moved_scans(self.store, poses, self.voxel_map, self._config)
            if moved:
                self._work = Reintegration(self.voxel_map, self.store, moved)
        return self._work is not None

    def correct_more(self) -> ReintegrationReport | None:
        """Do a part of the correction, as long as about one scan takes.

        Returns:
            What was done when this was the last part, else None.

        Raises:
            CapacityError: map and work do not fit into the memory limit. The correction is given
                up, the map is as it was.
        """
        work, self._work = self._work, None
        if work is None:
            return None
        if work.step():
            self._work = work
            return None
        report = work.finish()
        self._freeze()
        return report

    def correct(self) -> ReintegrationReport | None:
        """Correct the map at once; None where no scan belongs elsewhere.

        Raises:
            CapacityError: as `correct_more`.
        """
        report = None
        if self.begin_correction():
            while report is None:
                report = self.correct_more()
        return report

    def _freeze(self) -> None:
        """Give up scans beyond the memory, but not while the map is being corrected."""
        if self._work is None and self.store.freeze_excess():
            self._corrections.keep_only(scan.stamp for scan in self.store)
