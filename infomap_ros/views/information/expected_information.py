"""How much a camera pose is expected to tell about the map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.views.information import printed_metrics
from infomap_ros.views.information.field import VisibleField, workers_of
from infomap_ros.views.information.gains import field_around, ray_arrays
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.ray_kernels import view_bits
from infomap_ros.views.information.view_query import ViewQuery, checked_poses, checked_reach


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
