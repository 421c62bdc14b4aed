"""Which voxels a view is expected to inform, so that several views can count each of them once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, pack, table_slot
from infomap_ros.views.information.field import EMPTY, VisibleField, code_at
from infomap_ros.views.information.gains import field_around, ray_arrays
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.ray_kernels import region_steps, turned
from infomap_ros.views.information.view_query import (
    camera_rays,
    checked_poses,
    checked_reach,
    checked_region,
)


@dataclass(frozen=True, eq=False)
class VoxelGains:
    """What a view, or several, are expected to tell, voxel by voxel.

    Attributes:
        keys: packed voxel indices (`mapping.keys.pack`), ascending, shape (K,), int64.
        gains: shape (K,) [bits].
    """

    keys: NDArray[np.int64]
    gains: FloatArray

    @property
    def total(self) -> float:
        """All of it [bits]."""
        return float(self.gains.sum())

    def beyond(self, seen: VoxelGains) -> float:
        """What this view is expected to tell beyond what `seen` already tells [bits]."""
        _, mine, others = np.intersect1d(
            self.keys, seen.keys, assume_unique=True, return_indices=True
        )
        return self.total - float(np.minimum(self.gains[mine], seen.gains[others]).sum())

    def joined(self, other: VoxelGains) -> VoxelGains:
        """What both views tell together: of each voxel the larger gain, not the sum."""
        keys, place = np.unique(np.concatenate([self.keys, other.keys]), return_inverse=True)
        gains = np.zeros(len(keys))
        np.maximum.at(gains, place, np.concatenate([self.gains, other.gains]))
        return VoxelGains(keys, gains)


def view_gains(
    m: VoxelMap,
    pose: ArrayLike,
    camera: PinholeCamera,
    max_range: float,
    config: InformationConfig | None = None,
    region: ArrayLike | None = None,
    field: VisibleField | None = None,
) -> VoxelGains:
    """Voxels that one view is expected to inform; their sum is the view's information.

    Rays lie at most a voxel apart at `max_range`, closer than `ray_spacing` if need be, so that two
    views that see the same space find the same voxels.

    Args:
        m: the map.
        pose: T_map_camera of the optical frame, shape (4, 4).
        camera: its opening matters, its number of pixels does not.
        max_range: nothing farther is measured [m].
        config: rays and sensor.
        region: box (low, high), shape (2, 3), map frame [m]: only voxels in it count.
        field: of the map, as `gains.field_around` prepares it for all views that are asked for;
            without it, it is prepared for this view.

    Raises:
        InvalidInputError: an argument has a wrong shape or impossible content.
    """
    settings, size = config or InformationConfig(), m.config.voxel_size
    transform = checked_poses(pose)[0]
    reach = checked_reach(transform[:3, 3], max_range, size)
    field = field or field_around(m, transform[None, :3, 3], reach, settings)
    arrays = ray_arrays(field, m, reach, settings)
    rays, angles = camera_rays(camera, min(settings.ray_spacing, size / reach), settings.planar)
    placed = transform.copy()
    placed[:3, 3] = field.relative(transform[:3, 3])
    box, corner = field.relative(checked_region(region)), field.first * BLOCK_SIDE
    keys, gains, first = np.full(1 << 14, -1, np.int64), np.zeros(1 << 14), 0
    used = np.zeros(1, np.int64)
    while True:
        first = _gather(placed, rays, angles, first, box, corner, arrays, keys, gains, used)
        if first == len(rays):
            break
        keys, gains = _enlarged(keys, gains, len(arrays.gains))
    taken = np.flatnonzero(keys >= 0)
    order = taken[np.argsort(keys[taken], kind="stable")]
    return VoxelGains(keys[order], gains[order])


def _enlarged(
    keys: NDArray[np.int64], gains: FloatArray, needed: int
) -> tuple[NDArray[np.int64], FloatArray]:
    """The same hash table with more room, at least for `needed` more entries."""
    size = 4 * len(keys) + 4 * needed
    more_keys, more_gains = np.full(size, -1, np.int64), np.zeros(size)
    _copy(keys, gains, more_keys, more_gains)
    return more_keys, more_gains


@kernel
def _place(keys: Any, key: int) -> Any:
    """Where a key is in the hash table, or where it belongs."""
    place = table_slot(key, len(keys))
    while keys[place] >= 0 and keys[place] != key:
        place += 1
        if place == len(keys):
            place = 0
    return place


@kernel
def _copy(keys: Any, gains: Any, more_keys: Any, more_gains: Any) -> None:
    for i in range(len(keys)):
        if keys[i] >= 0:
            place = _place(more_keys, keys[i])
            more_keys[place], more_gains[place] = keys[i], gains[i]


@kernel
def _gather(
    pose: Any,
    rays: Any,
    angles: Any,
    first: int,
    box: Any,
    corner: Any,
    arrays: Any,
    keys: Any,
    gains: Any,
    used: Any,
) -> int:
    """Add the gains of rays, from `first`, to the hash table until it could overflow.

    Returns:
        First ray that was not cast, or the number of rays.
    """
    ox, oy, oz = pose[0, 3], pose[1, 3], pose[2, 3]
    low, high = (box[0, 0], box[0, 1], box[0, 2]), (box[1, 0], box[1, 1], box[1, 2])
    x0, y0, z0 = corner[0], corner[1], corner[2]
    steps, step = len(arrays.gains), arrays.step
    for ray in range(first, len(rays)):
        if 2 * (used[0] + steps) > len(keys):
            return ray
        dx, dy, dz = turned(pose, rays[ray])
        start, end = region_steps((ox, oy, oz), (dx, dy, dz), low, high, step, steps)
        visible = 1.0
        for n in range(end):
            r = (n + 0.5) * step
            x, y = math.floor(ox + dx * r), math.floor(oy + dy * r)
            z = math.floor(oz + dz * r)
            code = code_at(arrays.directory, arrays.codes, x, y, z)
            if code == EMPTY:
                continue
            gain = visible * angles[ray] * arrays.gains[n, code]
            if n >= start and gain > 0.0:
                key = pack(x + x0, y + y0, z + z0)
                place = _place(keys, key)
                used[0] += keys[place] < 0
                keys[place] = key
                gains[place] += gain
            visible *= arrays.clear[code]
            if visible < arrays.least:
                break
    return len(rays)
