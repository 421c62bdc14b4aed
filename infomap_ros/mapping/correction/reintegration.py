"""Putting scans where they belong after their poses were corrected.

When a camera that has drifted sees its target again, all it saw on the way is in the wrong place,
and new scans would draw every surface a second time. The blocks of the map that a moved scan can
have touched, from where it was taken to be and from where it was, are made again of all the scans
that touch them; the others stay. The map is then to the bit the one that the same scans make from
the corrected poses (Gaussians within rounding where scans were frozen). So no ghost of the old
surface stays.

The work goes scan by scan, beside the map, so that a map that is in use stays as it was until the
end, and new scans may be added meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry import check_covariance, check_transforms
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.correction.scan_store import (
    KeptScan,
    ScanKey,
    ScanStore,
    integrate_record,
)
from infomap_ros.mapping.scans.view_volume import ViewVolume, mark_blocks, touches_any, view_volume
from infomap_ros.mapping.voxel_map import VoxelMap
from infomap_ros.mapping.voxels.block_exchange import exchange_blocks
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT

# Scans follow a corrected pose when their points move by more than this [voxels].
_MIN_CORRECTION = 0.5
ScanPose = tuple[FloatArray, FloatArray | None]
"""T_map_sensor, shape (4, 4), and its covariance, shape (6, 6), or None for the one there was."""


@dataclass(frozen=True)
class ReintegrationReport:
    """What a re-integration did.

    Attributes:
        scans_moved: scans with a new pose.
        scans_integrated: scans of which blocks were made again, the moved ones among them.
        blocks_rebuilt: blocks that were made again, or are new.
        largest_correction: how far a point was moved at the most [m].
    """

    scans_moved: int
    scans_integrated: int
    blocks_rebuilt: int
    largest_correction: float


def corrections(scans: Sequence[KeptScan], transforms: FloatArray, max_range: float) -> FloatArray:
    """How far other poses move the points of scans at the most.

    Args:
        scans: N of them.
        transforms: their other poses, shape (N, 4, 4).
        max_range: points beyond it do not count [m].

    Returns:
        Shape (N,) [m].
    """
    if not scans:
        return np.zeros(0)
    change = transforms - np.array([scan.transform for scan in scans])
    distances = np.minimum([scan.record.farthest for scan in scans], max_range)
    # Of two rotations by an angle a from each other this norm is 2 sqrt(2) sin(a / 2).
    turns = np.linalg.norm(change[:, :3, :3], axis=(1, 2)) / np.sqrt(2.0)
    return np.asarray(np.linalg.norm(change[:, :3, 3], axis=1) + distances * turns)


def moved_scans(
    store: ScanStore,
    new_poses: Mapping[ScanKey, tuple[ArrayLike, ArrayLike | None]],
    voxel_map: VoxelMap,
) -> dict[int, ScanPose]:
    """The new poses of the scans that move far enough, by number of the scan.

    Args:
        store: the scans.
        new_poses: T_map_sensor and covariance, or None for the one there was, by `KeptScan.key`.
        voxel_map: that the scans are in.

    Raises:
        InvalidInputError: a pose or a covariance is none.
    """
    least = _MIN_CORRECTION * voxel_map.config.voxel_size
    scans = [scan for scan in store if scan.key in new_poses]
    if not scans:
        return {}
    transforms = check_transforms(np.array([new_poses[s.key][0] for s in scans]), "new poses")
    far = corrections(scans, transforms, voxel_map.config.max_range) > least
    moved: dict[int, ScanPose] = {}
    for place in np.flatnonzero(far).tolist():
        covariance = new_poses[scans[place].key][1]
        if covariance is not None:
            covariance = check_covariance(covariance, 6, "covariance of a new pose")
        moved[scans[place].number] = transforms[place], covariance
    return moved


class Reintegration:
    """One correction of a map. Until it is finished, neither freeze scans nor move others.

    Args:
        voxel_map: the map.
        store: its scans.
        moved: new poses by number of the scan.
    """

    def __init__(
        self, voxel_map: VoxelMap, store: ScanStore, moved: Mapping[int, ScanPose]
    ) -> None:
        self._map, self._store, self._moved = voxel_map, store, dict(moved)
        self._fresh = VoxelMap.from_state(voxel_map.config, store.base.state())
        self._affected = np.zeros(0, np.bool_)
        self._views = self._moved_views()
        self._scans = self._integrated = 0

    def step(self) -> bool:
        """Work on the next scan; False when there is none left.

        Raises:
            CapacityError: map and work do not fit into the memory limit. The map is as it was.
        """
        scan = self._store.first_from(self._scans)
        if scan is None:
            return False
        self._scans = scan.number + 1
        transform, covariance = self._moved.get(scan.number, (scan.transform, None))
        if scan.number in self._moved or self._is_affected(scan):
            known = scan.uncertainty_of(covariance)
            integrate_record(self._fresh, scan.record, transform, known)
            self._integrated += 1
        return True

    def finish(self) -> ReintegrationReport:
        """Do what is left, and put the result into the map."""
        while self.step():
            pass
        self._mark_affected()
        old, fresh = self._map._storage, self._fresh._storage
        before = int(old.blocks.counts[BLOCK_COUNT])
        self._map._storage = exchange_blocks(old, fresh, self._affected)
        after = int(self._map._storage.blocks.counts[BLOCK_COUNT])
        scans = [scan for scan in self._store if scan.number in self._moved]
        transforms = np.array([self._moved[scan.number][0] for scan in scans])
        largest = corrections(scans, transforms, self._map.config.max_range)
        self._store.move(self._moved)
        return ReintegrationReport(
            len(self._moved),
            self._integrated,
            int(np.count_nonzero(self._affected)) + after - before,
            float(largest.max(initial=0.0)),
        )

    def _moved_views(self) -> list[ViewVolume]:
        """Where the moved scans may have informed the map, from the old poses and the new."""
        config, views = self._map.config, []
        for scan in self._store:
            if scan.number in self._moved:
                transform = self._moved[scan.number][0]
                views.append(scan.view(config))
                views.append(
                    view_volume(transform, scan.record.camera, scan.record.farthest, config)
                )
        return views

    def _is_affected(self, scan: KeptScan) -> bool:
        """Whether a scan that stays may have touched a block that is made again."""
        self._mark_affected()
        keys = self._keys()[self._affected]
        return touches_any(scan.view(self._map.config), self._map.config, keys)

    def _mark_affected(self) -> None:
        """Mark the blocks that are made again, also those that are new in the map."""
        keys, known = self._keys(), len(self._affected)
        if len(keys) > known:
            fresh = np.zeros(len(keys) - known, np.bool_)
            for view in self._views:
                mark_blocks(view, self._map.config, keys[known:], fresh)
            self._affected = np.concatenate([self._affected, fresh])

    def _keys(self) -> NDArray[np.int64]:
        blocks = self._map._storage.blocks
        return blocks.keys[: int(blocks.counts[BLOCK_COUNT])]
