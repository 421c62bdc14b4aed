"""The information of candidate views as the choice asks for it.

How much a camera pose is expected to tell about the map.

Which voxels a view is expected to inform, so that several views can count each of them once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, pack, table_slot
from infomap_ros.views.information import printed_metrics
from infomap_ros.views.information.field import EMPTY, VisibleField, code_at, workers_of
from infomap_ros.views.information.gains import field_around, ray_arrays
from infomap_ros.views.information.ray_kernels import region_steps, turned, view_bits
from infomap_ros.views.information.view_query import (
    InformationConfig,
    ViewQuery,
    camera_rays,
    checked_poses,
    checked_reach,
    checked_region,
)
from infomap_ros.views.situation import Situation


def expected_entropy_reduction(query: ViewQuery) -> FloatArray:
    """Bits that one scan from each pose is expected to take off the map's entropy, shape (M,).

    The sum over the voxels in view of what one observation of each is expected to tell, see
    `views.observation_value`, times the probability that known obstacles before it do not hide it.
    An unknown voxel has 1 bit to lose, as `VoxelMap.entropy_bits` counts it; a known one counts
    with ``known_weight``. It is 0 if everything in view is known and empty; falls when the view is
    occluded; grows with every unknown voxel in view; and grows where known voxels are nearer to
    0.5: the intent that Sujan and Dubowsky (2005, doi:10.1177/0278364905051774) state for eqs. (7)
    to (9). With a ``wanted_sigma`` it also counts what the scan tells about where surfaces lie.

    Bits depend on the voxel size, as entropy does; bits times the volume of a voxel is a volume of
    unknown space that does not.
    """
    if len(query.poses) == 0:
        return np.zeros(0)
    m, config = query.voxel_map, query.config
    return bits_in(field_around(m, query.places, query.max_range, config, query.threads), query)


def bits_in(field: VisibleField, query: ViewQuery) -> FloatArray:
    """The same by a field that was prepared about the views."""
    threads = query.threads
    arrays = ray_arrays(field, query.voxel_map, query.max_range, query.config)
    poses, rays, angles, box = query.placed_in(field)
    parts = np.zeros((threads, len(poses)))

    def cast(part: int, first: int, last: int) -> None:
        view_bits(poses, rays[first:last], angles[first:last], box, arrays, parts[part])

    workers_of(threads).run(cast, len(rays))
    return np.asarray(parts.sum(axis=0))


Metric = Callable[[ViewQuery], FloatArray]
"""What counts as information: a number for each view, shape (M,)."""
METRICS: dict[str, Metric] = {
    "expected_entropy_reduction": expected_entropy_reduction,
    "scene_entropy": printed_metrics.scene_entropy,
    "stretched_scene_entropy": printed_metrics.stretched_scene_entropy,
    "weighted_scene_entropy": printed_metrics.weighted_scene_entropy,
}
"""Metrics by name; each one's documentation says its unit."""


def expected_information(
    m: VoxelMap,
    poses: ArrayLike,
    camera: PinholeCamera,
    max_range: float,
    metric: str | Metric = "expected_entropy_reduction",
    config: InformationConfig | None = None,
    region: ArrayLike | None = None,
    threads: int = 1,
) -> FloatArray:
    """How much a scan from each camera pose is expected to tell.

    Args:
        m: the map.
        poses: T_map_camera of the optical frame, shape (M, 4, 4).
        camera: opening of the camera; its number of pixels does not matter.
        max_range: nothing farther is measured [m].
        metric: a function, or the name of one of `METRICS`, which says its unit; the default is in
            bits.
        config: rays and sensor.
        region: box (low, high), shape (2, 3), map frame [m]: only voxels in it count.
        threads: that share the rays.

    Returns:
        Shape (M,).

    Raises:
        InvalidInputError: an argument has a wrong shape or impossible content, or there is no such
            metric.
    """
    if isinstance(metric, str) and metric not in METRICS:
        raise InvalidInputError("metric", f"'{metric}' is none of {', '.join(METRICS)}")
    transforms = checked_poses(poses)
    reach = checked_reach(transforms[:, :3, 3], max_range, m.config.voxel_size)
    settings = config or InformationConfig()
    value = METRICS[metric] if isinstance(metric, str) else metric
    return value(ViewQuery(m, transforms, camera, reach, settings, region, threads))


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


_BITS = "expected_entropy_reduction"  # the metric that counts bits of the map


class ExpectedInformation:
    """Information by one of the metrics, an `InformationSource`."""

    def __init__(
        self,
        metric: str | Metric = "expected_entropy_reduction",
        config: InformationConfig | None = None,
        quick_ray_spacing: float = 0.05,
        threads: int = 2,
    ) -> None:
        """Choose what counts as information.

        Args:
            metric: the name of one of `METRICS`, or a function.
            config: rays and sensor.
            quick_ray_spacing: angle between the rays of the first ranking of all candidates [rad].
            threads: that share the rays.

        Raises:
            ConfigError: there is no such metric.
        """
        if isinstance(metric, str) and metric not in METRICS:
            raise ConfigError("metric", metric, "one of " + ", ".join(METRICS))
        self._metric, self._threads = metric, threads
        name = metric if isinstance(metric, str) else metric.__name__
        self.unit = "bits" if name == _BITS else f"of {name}"
        self._config = config or InformationConfig()
        spacing = max(quick_ray_spacing, self._config.ray_spacing)
        self._quick_config = replace(self._config, ray_spacing=spacing)
        self._full_views: dict[tuple[VoxelMapConfig, PinholeCamera, float, bool], float] = {}

    @property
    def config(self) -> InformationConfig:
        """Rays and sensor."""
        return self._config

    def quick(
        self, situation: Situation, positions: FloatArray, rotations: FloatArray
    ) -> FloatArray:
        """Of all orientations (P, O, 3, 3) at positions (P, 3), with few rays: (P, O)."""
        poses = np.tile(np.eye(4), (*rotations.shape[:2], 1, 1))
        poses[..., :3, :3] = rotations
        poses[..., :3, 3] = positions[:, None]
        values = self._evaluate(situation, poses.reshape(-1, 4, 4), self._quick_config)
        return values.reshape(rotations.shape[:2])

    def exact(self, situation: Situation, poses: FloatArray) -> FloatArray:
        """Of views ``T_map_camera``, shape (M, 4, 4): (M,)."""
        return self._evaluate(situation, poses, self._config)

    def full_view(self, situation: Situation) -> float:
        """Of a view into nothing but unknown space.

        By the same metric, so that shares of it do not depend on the metric's unit. 0 for metrics
        that unknown space tells nothing.
        """
        settings, planar = situation.voxel_map.config, situation.is_planar
        key = (settings, situation.camera, situation.max_range, planar)
        if key not in self._full_views:
            nothing = VoxelMap(situation.voxel_map.config)
            value = expected_information(
                nothing,
                np.eye(4)[None],
                situation.camera,
                situation.max_range,
                self._metric,
                _fitting(self._config, situation),
            )
            self._full_views[key] = float(value[0])
        return self._full_views[key]

    def gains(self, situation: Situation, poses: FloatArray) -> list[VoxelGains]:
        """Voxels that each view, (M, 4, 4), informs, by the expected reduction of entropy."""
        found: dict[int, VoxelGains] = {}
        if len(poses) == 0:
            return []
        config, field = _fitting(self._config, situation), self._field_about(situation, poses)

        def gather(_: int, first: int, last: int) -> None:
            for index in range(first, last):
                found[index] = view_gains(
                    situation.promising_map,
                    poses[index],
                    situation.camera,
                    situation.max_range,
                    config,
                    self._region(situation),
                    field,
                )

        workers_of(self._threads).run(gather, len(poses))
        return [found[index] for index in range(len(poses))]

    def _evaluate(
        self, situation: Situation, poses: FloatArray, config: InformationConfig
    ) -> FloatArray:
        return expected_information(
            situation.promising_map,
            poses,
            situation.camera,
            situation.max_range,
            self._metric,
            _fitting(config, situation),
            self._region(situation),
            self._threads,
        )

    def _field_about(self, situation: Situation, poses: FloatArray) -> VisibleField:
        """What of the map can be seen from views, (M, 4, 4)."""
        config = _fitting(self._config, situation)
        return field_around(situation.promising_map, poses[:, :3, 3], situation.max_range, config)

    @staticmethod
    def _region(situation: Situation) -> FloatArray:
        """Box of the voxels that count, shape (2, 3) [m, map]."""
        return np.stack([situation.region.low, situation.region.high])


def _fitting(config: InformationConfig, situation: Situation) -> InformationConfig:
    """The configuration for a task in a plane or in space."""
    return replace(config, planar=True) if situation.is_planar else config
