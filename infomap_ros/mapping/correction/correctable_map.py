"""A map that follows the poses of its scans as they are corrected."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from infomap_ros.geometry import (
    PinholeCamera,
    PlacedSolid,
    PoseUncertainty,
    check_transform,
    float_array,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.correction.body_removal import forget_body
from infomap_ros.mapping.correction.keyframe_covariances import KeyframeCovariances
from infomap_ros.mapping.correction.pose_corrections import PoseCorrections
from infomap_ros.mapping.correction.reintegration import (
    Reintegration,
    ReintegrationConfig,
    ReintegrationReport,
    moved_scans,
)
from infomap_ros.mapping.correction.scan_store import ScanStore, ScanStoreConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig
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
        self._corrections, self._covariances = PoseCorrections(), KeyframeCovariances()
        self._came: dict[int, FloatArray | None] = {}  # covariances of poses as they came
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
        pose_covariance: ArrayLike | PoseUncertainty | None = None,
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
            self._came[stamp] = _covariance(pose_covariance)
        self._freeze()
        return report

    def hear(
        self,
        as_of: int,
        stamps: ArrayLike,
        transforms: ArrayLike,
        covariances: ArrayLike | None = None,
    ) -> None:
        """Hear of corrected poses; see `PoseCorrections.hear`.

        Args:
            as_of: the moment whose image was used last for them [ns].
            stamps: of the keyframes, shape (K,) [ns].
            transforms: T_map_sensor, shape (K, 4, 4).
            covariances: of the poses, shape (K, 6, 6); scans keep theirs where not given.

        Raises:
            InvalidInputError: a pose or a covariance is none, or the stamps do not fit.
        """
        if covariances is not None:
            self._covariances.hear(as_of, stamps, transforms, covariances)
        self._corrections.hear(as_of, stamps, transforms)

    def forget_body(
        self,
        solids: Sequence[PlacedSolid],
        config: BodyFilterConfig | None = None,
        ground: FloatArray | None = None,
    ) -> int:
        """Take a body out of the map and its scans that was not known when they were fused.

        A correction that has begun begins again.

        Args:
            solids: of the body, placed in the map.
            config: how far it is grown.
            ground: that on which it stands and which stays, as `body_removal.forget_body` takes it.

        Returns:
            Number of occupied voxels that are unknown now.
        """
        self.store.forget_body(solids, config, ground)
        forgotten = forget_body(self.voxel_map, solids, config, ground)
        if self._work is not None:
            self._work = None
            self.begin_correction()
        return forgotten

    def begin_correction(self) -> bool:
        """Begin to correct the map where scans belong elsewhere by now; whether there are any."""
        if self._work is None:
            moved = moved_scans(self.store, self._poses(), self.voxel_map, self._config)
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

    def _poses(self) -> dict[int, tuple[FloatArray, FloatArray | None]]:
        """Where the scans belong by now, and how well that is known, by stamp."""
        known = self._covariances
        return {
            stamp: (pose, known.of_scan(stamp, pose, self._came.get(stamp)))
            for stamp, (pose, _) in self._corrections.poses.items()
        }

    def _freeze(self) -> None:
        """Give up scans beyond the memory, but not while the map is being corrected."""
        if self._work is None and self.store.freeze_excess():
            self._corrections.keep_only(scan.stamp for scan in self.store)
            self._came = {scan.stamp: self._came.get(scan.stamp) for scan in self.store}


def _covariance(given: ArrayLike | PoseUncertainty | None) -> FloatArray | None:
    """Of a pose as a whole, shape (6, 6)."""
    if given is None:
        return None
    whole = given.covariance if isinstance(given, PoseUncertainty) else given
    return float_array(whole, "pose_covariance")
