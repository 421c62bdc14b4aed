"""How much a camera pose is expected to tell about the map."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.views.information import printed_metrics, published_metrics
from infomap_ros.views.information.entropy_reduction import expected_entropy_reduction
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.rays import checked_poses, checked_reach
from infomap_ros.views.information.view_query import ViewQuery

METRICS: Mapping[str, Callable[[ViewQuery], FloatArray]] = {
    "expected_entropy_reduction": expected_entropy_reduction,
    "scene_entropy": printed_metrics.scene_entropy,
    "stretched_scene_entropy": printed_metrics.stretched_scene_entropy,
    "weighted_scene_entropy": printed_metrics.weighted_scene_entropy,
    "occlusion_aware": published_metrics.occlusion_aware,
    "unobserved_voxels": published_metrics.unobserved_voxels,
    "rear_side_voxel": published_metrics.rear_side_voxel,
    "rear_side_entropy": published_metrics.rear_side_entropy,
    "proximity_count": published_metrics.proximity_count,
    "average_entropy": published_metrics.average_entropy,
    "area_factor": published_metrics.area_factor,
}
"""Metrics by name; each one's documentation says its unit."""


def expected_information(
    m: VoxelMap,
    poses: ArrayLike,
    camera: PinholeCamera,
    max_range: float,
    metric: str = "expected_entropy_reduction",
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
        metric: one of `METRICS`, which says its unit; the default is in bits.
        config: rays and sensor.
        region: box (low, high), shape (2, 3), map frame [m]: only voxels in it count.
        threads: that share the rays.

    Returns:
        Shape (M,).

    Raises:
        InvalidInputError: an argument has a wrong shape or impossible content, or there is no such
            metric.
    """
    if metric not in METRICS:
        raise InvalidInputError("metric", f"'{metric}' is none of {', '.join(METRICS)}")
    transforms = checked_poses(poses)
    reach = checked_reach(transforms[:, :3, 3], max_range, m.config.voxel_size)
    settings = config or InformationConfig()
    return METRICS[metric](ViewQuery(m, transforms, camera, reach, settings, region, threads))
