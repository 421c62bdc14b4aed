"""The scans that a map was made of, with the poses from which they were taken.

Where a pose turns out to have been wrong, its scan can be put where it belongs
(`infomap_ros.mapping.correction.reintegration`). Memory is bounded: scans that no longer fit are
frozen. A frozen scan stays in the map where it is and its record is given up; those are frozen
first whose poses are known best, because they will be corrected least, and of equally good ones
the oldest.
What cannot be corrected is a map of its own, the base: the frozen scans, and the content of a map
file, which has no scans.

A body taken out of what was fused before anybody knew that it is one.

A robot that stands in view before it joins, or while it is silent for long, is a part of the scene
to who looks at it. When it is heard, it would stand within its own image, and could not move.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.geometry import (
    PinholeCamera,
    PlacedSolid,
    PoseUncertainty,
    check_transform,
    invert_transform,
)
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.correction.scan_record import ScanRecord, keep_scan
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.mapping.scans.integration import IntegrationReport
from infomap_ros.mapping.scans.view_volume import ViewVolume, view_volume
from infomap_ros.mapping.voxel_map import VoxelMap
from infomap_ros.mapping.voxels.block_exchange import exchange_blocks
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT, pack_all
from infomap_ros.mapping.voxels.state import put_states, unknown_states


def forget_body(
    voxel_map: VoxelMap,
    solids: Sequence[PlacedSolid],
    config: BodyFilterConfig | None = None,
    ground: FloatArray | None = None,
) -> int:
    """Make the occupied voxels of a body unknown; they count as changed.

    A voxel is of the body by the rule for points of scans (`infomap_ros.mapping.scans.body`): its
    surface point is, or where it has none its center, of which it may be anywhere in the voxel.

    Args:
        voxel_map: the map.
        solids: of the body, placed in the map.
        config: how far it is grown.
        ground: (n, d), shape (4,): what lies at p with ``n . p < d`` [m] is that on which the body
            stands, and stays.

    Returns:
        Number of the voxels.
    """
    if not solids:
        return 0
    size = voxel_map.config.voxel_size
    indices, log_odds = voxel_map.voxels()
    occupied = indices[log_odds > 0.0]
    surface, means, covariances = voxel_map.gaussians(relative=True)
    has_surface = np.isin(pack_all(occupied.astype(np.int64)), pack_all(surface.astype(np.int64)))
    bare = occupied[~has_surface]
    anywhere = np.broadcast_to(size**2 / 12.0 * np.eye(3), (len(bare), 3, 3))
    centers = (bare + 0.5) * size
    of_body = body_mask(centers, anywhere, solids, config)
    surface_of_body = body_mask(means, covariances, solids, config)
    if ground is not None:
        of_body &= centers @ ground[:3] >= ground[3] + 0.5 * size
        surface_of_body &= means @ ground[:3] >= ground[3]
    forgotten = np.concatenate([bare[of_body], surface[surface_of_body]])
    if len(forgotten):
        _forget(voxel_map, forgotten)
    return len(forgotten)


def _forget(voxel_map: VoxelMap, indices: NDArray[np.int32]) -> None:
    """Make voxels unknown, shape (K, 3)."""
    fresh = VoxelMap.from_state(voxel_map.config, voxel_map.state())
    put_states(fresh._storage, unknown_states(indices))
    everywhere = np.ones(int(voxel_map._storage.blocks.counts[BLOCK_COUNT]), np.bool_)
    voxel_map._storage = exchange_blocks(voxel_map._storage, fresh._storage, everywhere)


def without_body(
    record: ScanRecord,
    T_map_sensor: FloatArray,
    solids: Sequence[PlacedSolid],
    config: BodyFilterConfig | None = None,
) -> ScanRecord | None:
    """A kept scan without its points on a body; None where there are none.

    Args:
        record: the scan.
        T_map_sensor: shape (4, 4).
        solids: of the body, placed in the map.
        config: how far it is grown.
    """
    T_sensor_map = invert_transform(T_map_sensor)
    placed = [PlacedSolid(s.solid, T_sensor_map @ s.transform, s.name) for s in solids]
    scan = record.restore()
    on_body = body_mask(scan.points, scan.covariances, placed, config)
    if not on_body.any():
        return None
    points = np.where(on_body[..., None], np.float32(np.nan), scan.points)
    cut = keep_scan(points, scan.covariances, scan.camera, scan.error_correlation)
    return replace(cut, farthest=record.farthest)


@dataclass(frozen=True)
class ScanStoreConfig:
    """How many scans are kept.

    Raises:
        ConfigError: a value is out of its range.
    """

    memory: float = setting(
        1.0,
        "Memory for scans that can be moved when poses are corrected; those beyond it stay where "
        "they are. 0 keeps none.",
        unit="GB",
        low=0.0,
        high=1024.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


ScanKey = tuple[int, str]
"""Stamp [ns] and sensor of a scan: two sensors may measure at the same moment."""


@dataclass(frozen=True, eq=False)
class KeptScan:
    """A scan with the pose by which it is in the map.

    Attributes:
        number: of the scan in its store, ascending.
        stamp: [ns].
        record: the scan.
        transform: T_map_sensor, shape (4, 4).
        uncertainty: of the pose, or None where unknown.
        sensor: frame that took it; empty for the camera of which localization gives the pose.
    """

    number: int
    stamp: int
    record: ScanRecord
    transform: FloatArray
    uncertainty: PoseUncertainty | None
    sensor: str = ""

    @property
    def key(self) -> ScanKey:
        """Which scan it is for who corrects poses."""
        return self.stamp, self.sensor

    def uncertainty_of(self, covariance: FloatArray | None) -> PoseUncertainty | None:
        """That of its pose when the pose's covariance has become another; None: it has not."""
        if covariance is None or self.uncertainty is None:
            return self.uncertainty if covariance is None else PoseUncertainty(covariance)
        return self.uncertainty.with_covariance(covariance)

    def view(self, config: VoxelMapConfig) -> ViewVolume:
        """Where the scan may have informed a map."""
        return view_volume(self.transform, self.record.camera, self.record.farthest, config)

    def expected_correction(self, reach: float) -> float:
        """How far a point at distance `reach` [m] may move by the pose's covariance [m]."""
        if self.uncertainty is None:
            return 0.0
        sigmas = np.sqrt(np.diag(self.uncertainty.covariance))
        distance = min(self.record.farthest, reach)
        return float(np.linalg.norm(sigmas[:3]) + distance * np.linalg.norm(sigmas[3:]))


class ScanStore:
    """Scans in the order in which they came.

    Args:
        map_config: of the map that the scans are integrated into.
        config: how many are kept.
        base: a map whose content is kept as it is, for example a loaded one; copied.
    """

    def __init__(
        self,
        map_config: VoxelMapConfig,
        config: ScanStoreConfig | None = None,
        base: VoxelMap | None = None,
    ) -> None:
        self.config = config or ScanStoreConfig()
        self._map_config = map_config
        state = base.state() if base else None
        self._base = VoxelMap.from_state(map_config, state) if state else VoxelMap(map_config)
        self._scans: dict[int, KeptScan] = {}
        self._bytes = 0
        self._number = 0
        self._frozen = 0

    def __len__(self) -> int:
        return len(self._scans)

    def __iter__(self) -> Iterator[KeptScan]:
        return iter(tuple(self._scans.values()))

    @property
    def base(self) -> VoxelMap:
        """What is in the map for good. It is the store's own: read it only."""
        return self._base

    @property
    def frozen(self) -> int:
        """Number of scans that were given up so far."""
        return self._frozen

    def memory_bytes(self) -> int:
        """Memory in use by scans and base [bytes]."""
        return self._bytes + self._base.memory_bytes()

    def integrate(
        self,
        voxel_map: VoxelMap,
        stamp: int,
        points: ArrayLike,
        T_map_sensor: ArrayLike,
        covariances: ArrayLike | None = None,
        pose_covariance: ArrayLike | PoseUncertainty | None = None,
        camera: PinholeCamera | None = None,
        error_correlation: float | None = None,
        sensor: str = "",
    ) -> IntegrationReport:
        """Add a scan of a `sensor` to a map as `VoxelMap.integrate` does, and keep it.

        The map gets what is kept, so that it can be made again to the bit.

        Raises:
            InvalidInputError: as there. Nothing is kept.
            CapacityError: as there. Nothing is kept.
        """
        if self.config.memory == 0.0:
            return voxel_map.integrate(
                points, T_map_sensor, covariances, pose_covariance, camera, error_correlation
            )
        record = keep_scan(points, covariances, camera, error_correlation)
        uncertainty = voxel_map.pose_uncertainty(pose_covariance, T_map_sensor)
        report = integrate_record(voxel_map, record, T_map_sensor, uncertainty)
        self.add(stamp, record, T_map_sensor, uncertainty, sensor)
        return report

    def add(
        self,
        stamp: int,
        record: ScanRecord,
        T_map_sensor: ArrayLike,
        uncertainty: PoseUncertainty | None = None,
        sensor: str = "",
    ) -> None:
        """Keep a scan of a `sensor` that was integrated from `record`.

        Raises:
            InvalidInputError: the pose is none.
        """
        transform = check_transform(T_map_sensor, "T_map_sensor")
        scan = KeptScan(self._number, stamp, record, transform, uncertainty, sensor)
        self._scans[self._number] = scan
        self._number += 1
        self._bytes += record.memory_bytes()

    def freeze_excess(self) -> int:
        """Give up the scans that do not fit into the memory; returns how many.

        Where the base has no room for them they stay.
        """
        before = self._frozen
        while self._bytes > self.config.memory * 1e9:
            number = min(self._scans, key=self._usefulness)
            scan = self._scans[number]
            try:
                integrate_record(self._base, scan.record, scan.transform, scan.uncertainty)
            except CapacityError:
                break
            del self._scans[number]
            self._bytes -= scan.record.memory_bytes()
            self._frozen += 1
        return self._frozen - before

    def first_from(self, number: int) -> KeptScan | None:
        """The first scan with this number or a larger one, None where there is none."""
        return next((scan for key, scan in self._scans.items() if key >= number), None)

    def move(self, poses: Mapping[int, tuple[FloatArray, FloatArray | None]]) -> None:
        """Note that scans are in the map by other poses now.

        Args:
            poses: (T_map_sensor, covariance or None for the one it had) by number of the scan.
        """
        for number, (transform, covariance) in poses.items():
            old = self._scans[number]
            known = old.uncertainty_of(covariance)
            self._scans[number] = replace(old, transform=transform, uncertainty=known)

    def forget_body(
        self,
        solids: Sequence[PlacedSolid],
        config: BodyFilterConfig | None = None,
        ground: FloatArray | None = None,
    ) -> None:
        """Take a body out of all scans and out of the base, as if it had been cut from them.

        Args:
            solids: of the body, placed in the map.
            config: how far it is grown.
            ground: of the base that which stays, as `body_removal.forget_body` takes it.
        """
        forget_body(self._base, solids, config, ground)
        for number, scan in self._scans.items():
            cut = without_body(scan.record, scan.transform, solids, config)
            if cut is not None:
                self._bytes += cut.memory_bytes() - scan.record.memory_bytes()
                self._scans[number] = replace(scan, record=cut)

    def _usefulness(self, number: int) -> tuple[int, int]:
        """Rank of a scan: expected correction in half voxels, then how new it is."""
        reach = self._map_config.max_range
        correction = self._scans[number].expected_correction(reach)
        return int(min(correction / (0.5 * self._map_config.voxel_size), 1e9)), number


def integrate_record(
    voxel_map: VoxelMap,
    record: ScanRecord,
    T_map_sensor: ArrayLike,
    pose_covariance: ArrayLike | PoseUncertainty | None,
) -> IntegrationReport:
    """Add a kept scan to a map.

    Raises:
        InvalidInputError: as `VoxelMap.integrate`.
        CapacityError: likewise.
    """
    scan = record.restore()
    return voxel_map.integrate(
        scan.points,
        T_map_sensor,
        scan.covariances,
        pose_covariance,
        scan.camera,
        scan.error_correlation,
    )
