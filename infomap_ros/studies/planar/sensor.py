"""The range sensor of the planar experiments: a fan of rays without noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.views.information.view_query import camera_rays
from infomap_ros.views.sampling.orientations import look_rotations

_INSIDE = 0.02  # a hit is put so far into its voxel [voxels]
_COLUMNS = 128  # of the camera whose opening the sensor has
_THIN = 1e-3  # its opening across the plane [rad]


@dataclass(frozen=True)
class SensorConfig:
    """A planar range sensor.

    Raises:
        ConfigError: a value is out of its range.
    """

    field_of_view: float = parameter(90.0, "Opening.", unit="deg", low=1.0, high=170.0)
    max_range: float = parameter(15.0, "Depth of field.", unit="m", low=0.1, high=1000.0)
    ray_spacing: float = parameter(
        0.0125, "Largest angle between neighboring rays.", unit="rad", low=1e-4, high=0.1
    )

    def __post_init__(self) -> None:
        check_config(self)

    @cached_property
    def camera(self) -> PinholeCamera:
        """A camera of one row with that opening."""
        focal = 0.5 * _COLUMNS / math.tan(math.radians(0.5 * self.field_of_view))
        return PinholeCamera(_COLUMNS, 1, focal, 1.0 / _THIN, 0.5 * _COLUMNS - 0.5, 0.0)

    def map_config(self, cell: float) -> VoxelMapConfig:
        """A map of what the sensor sees: without noise, one look makes a voxel free or occupied."""
        return VoxelMapConfig(
            voxel_size=cell,
            max_range=self.max_range,
            probability_hit=0.97,
            probability_miss=0.04,
            association_sigmas=0.0,
            free_gap=0.0,
            error_correlation=0.0,
            default_sigma=1e-3 * cell,
        )


def level_pose(place: FloatArray, azimuth: float, cell: float) -> FloatArray:
    """``T_map_camera`` at a place, shape (2,) [m], in the middle of the layer of voxels."""
    rotation = look_rotations(np.array([azimuth]), np.zeros(1))[0]
    return make_transform(rotation, np.array([place[0], place[1], 0.5 * cell]))


def take_scan(
    truth: VoxelMap, sensor: SensorConfig, T_map_camera: FloatArray, voxel_map: VoxelMap
) -> None:
    """Measure the true map and add the scan to another one.

    Args:
        truth: see `PlanarWorld.truth`.
        sensor: that measures.
        T_map_camera: from where, shape (4, 4).
        voxel_map: receives the scan.
    """
    rays, _ = camera_rays(sensor.camera, sensor.ray_spacing, planar=True)
    directions = rays @ T_map_camera[:3, :3].T
    distances, hits = truth.first_occupied(T_map_camera[:3, 3], directions, sensor.max_range)
    beyond = 2.0 * sensor.max_range
    lengths = np.where(hits, distances + _INSIDE * truth.config.voxel_size, beyond)
    voxel_map.integrate(rays * lengths[:, None], T_map_camera)
