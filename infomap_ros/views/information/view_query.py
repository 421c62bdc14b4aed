"""Which views are to be rated: what every information metric is asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.views.information.codes import CodeBook
from infomap_ros.views.information.field import VisibleField, visible_field
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.rays import camera_rays, checked_region

FINEST = CodeBook(1e-6)
"""Codes that tell almost all voxels apart by their probability."""


class PlacedViews(NamedTuple):
    """Views as the kernels take them, all relative to the directory of a field [voxels].

    Attributes:
        poses: ``T_map_camera``, shape (M, 4, 4).
        rays: unit directions in the camera frame, shape (N, 3).
        angles: solid angle of each ray, shape (N,) [sr].
        box: the region that counts, (low, high) corners, shape (2, 3).
    """

    poses: FloatArray
    rays: FloatArray
    angles: FloatArray
    box: FloatArray


@dataclass(frozen=True, eq=False)
class ViewQuery:
    """Views of a map.

    Attributes:
        voxel_map: the map.
        poses: ``T_map_camera`` of the optical frame, shape (M, 4, 4), checked.
        camera: its opening matters, its number of pixels does not.
        max_range: nothing farther is measured [m], checked.
        config: rays and sensor.
        region: box (low, high), shape (2, 3), map frame [m]: only voxels in it count.
        threads: that share the rays.
    """

    voxel_map: VoxelMap
    poses: FloatArray
    camera: PinholeCamera
    max_range: float
    config: InformationConfig
    region: ArrayLike | None = None
    threads: int = 1

    @property
    def places(self) -> FloatArray:
        """Where the cameras are, shape (M, 3) [m]."""
        return np.asarray(self.poses[:, :3, 3])

    def finest_field(self) -> VisibleField:
        """The part of the map that can be seen, in the finest codes."""
        low = self.places.min(axis=0) - self.max_range
        return visible_field(self.voxel_map, low, self.places.max(axis=0) + self.max_range, FINEST)

    def placed_in(self, field: VisibleField) -> PlacedViews:
        """The views relative to a field.

        Raises:
            InvalidInputError: the region is not a box.
        """
        rays, angles = camera_rays(self.camera, self.config.ray_spacing, self.config.planar)
        poses = self.poses.copy()
        poses[:, :3, 3] = field.relative(self.places)
        return PlacedViews(poses, rays, angles, field.relative(checked_region(self.region)))
