"""Which views are to be rated: what every information metric is asked.

Configuration of what a view is expected to tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, PlacedSolid, StereoRig, float_array
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.views.information.field import CodeBook, VisibleField, visible_field

DISPARITY_SIGMA = 0.2
"""Standard deviation of a disparity that a pair is expected to measure [px]."""


@dataclass(frozen=True)
class InformationConfig:
    """How rays are laid, what the sensor can tell from afar, and what hides what.

    The noise law is that of eq. (1) of Sujan and Dubowsky (2005), ``sigma = S L^n`` of the distance
    L, and does not depend on the image that a camera of the same opening happens to have: a view's
    bits are the same for the full and for a reduced image.

    Raises:
        ConfigError: a value is out of its range.
    """

    ray_spacing: float = parameter(
        0.0125,
        "Largest angle between neighboring rays. Finer rays change nothing but the sampling error.",
        unit="rad",
        low=1e-4,
        high=0.5,
    )
    min_range: float = parameter(
        0.3, "Nearest distance at which the sensor measures.", unit="m", low=0.0, high=100.0
    )
    range_noise: float = parameter(
        0.004,
        "Standard deviation of the range of one pixel at 1 m, S of eq. (1); for a stereo pair "
        "disparity sigma / (focal length x baseline).",
        unit="m",
        low=0.0,
        high=10.0,
    )
    range_exponent: ClassVar[float] = 2.0
    """Growth of that deviation with distance, n of eq. (1)."""
    pixel_angle: float = parameter(
        0.002, "Angle between the sensor's own pixels.", unit="rad", low=1e-5, high=0.5
    )
    certain_probability: float = parameter(
        0.05,
        "A known voxel less likely occupied than this counts as empty, and one less likely empty "
        "than this as solid: neither has any information left.",
        low=1e-4,
        high=0.45,
    )
    known_weight: float = parameter(
        0.25,
        "Weight of the bits of known voxels. What one scan says of the voxels along a ray is right "
        "or wrong together, so that less is left to learn of them than the sum of their entropies. "
        "1 counts the sum, as `VoxelMap.entropy_bits` does.",
        low=0.0,
        high=1.0,
    )
    min_visibility: ClassVar[float] = 0.05
    """Where a place can be seen with a lower probability, it counts as hidden."""
    unknown_occlusion: float = parameter(
        0.0,
        "Probability that unknown space hides what is one max_range behind it. With 0 only known "
        "obstacles hide something, as in the paper, and the information grows with every unknown "
        "voxel in view.",
        low=0.0,
        high=0.99,
    )
    hiding_probability: float = parameter(
        0.5,
        "A known voxel less likely occupied than this hides nothing.",
        low=0.5,
        high=0.999,
    )
    predict_unknown: bool = parameter(
        False,
        "Whether unknown voxels near known ones have the average probability of their neighbors "
        "instead of 0.5. They are then worth less than 1 bit, and hide what is behind them where "
        "they are more likely occupied than not.",
    )

    wanted_sigma: float = parameter(
        0.0,
        "Standard deviation of a surface along its normal that suffices. What a view is expected "
        "to tell about where less precise surfaces lie then counts too; 0 counts none of it.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    coarse_sigma: float = parameter(
        0.0,
        "Standard deviation that suffices instead outside of `fine_places`, where that is larger.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    fine_places: tuple[PlacedSolid, ...] = ()
    """Where `wanted_sigma` is asked for, map frame; everywhere where there are none."""
    planar: bool = parameter(
        False,
        "The map is one layer of voxels, along which the camera looks: a ray stands for a sector "
        "of the layer, not for a pyramid, and near space counts accordingly more.",
    )

    def __post_init__(self) -> None:
        check_config(self)

    @classmethod
    def of_stereo(
        cls, rig: StereoRig, disparity_sigma: float = DISPARITY_SIGMA, min_range: float = 0.5
    ) -> InformationConfig:
        """Configuration with the noise law of a rectified pair.

        About surfaces and depth edges stereo leaves voxels with a part of a hit and some misses.
        Several in a row would hide for good what is behind a gap that they are in, so a voxel
        hides from one whole hit on.

        Args:
            rig: the pair, with its full image.
            disparity_sigma: standard deviation of a disparity [px].
            min_range: nearest distance that its disparity search reaches [m].
        """
        focal_length = rig.left.fx
        return cls(
            min_range=min_range,
            range_noise=disparity_sigma / (focal_length * rig.baseline),
            pixel_angle=1.0 / focal_length,
            hiding_probability=VoxelMapConfig.probability_hit,
        )


def camera_rays(
    camera: PinholeCamera, spacing: float, planar: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Rays through the middles of equal cells of the image.

    Args:
        camera: only its opening matters, not its number of pixels.
        spacing: largest angle between neighboring rays [rad].
        planar: one row of rays in the plane of x and z of the camera.

    Returns:
        Unit directions in the camera frame, shape (N, 3), row by row; and the solid angle of each
        cell, shape (N,) [sr], whose sum is that of the image. Of a plane the angle [rad] instead.
    """
    low_x, high_x = (-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
    if planar:
        edges = np.arctan(np.linspace(low_x, high_x, math.ceil((high_x - low_x) / spacing) + 1))
        azimuths = 0.5 * (edges[:-1] + edges[1:])
        level = np.stack([np.sin(azimuths), np.zeros_like(azimuths), np.cos(azimuths)], axis=-1)
        return level, np.diff(edges)
    low_y, high_y = (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy
    columns = max(1, math.ceil((high_x - low_x) / spacing))
    rows = max(1, math.ceil((high_y - low_y) / spacing))
    x, y = np.linspace(low_x, high_x, columns + 1), np.linspace(low_y, high_y, rows + 1)
    corner = np.arctan(x * y[:, None] / np.sqrt(1.0 + x**2 + y[:, None] ** 2))
    angles = np.diff(np.diff(corner, axis=0), axis=1)
    middle_x, middle_y = 0.5 * (x[:-1] + x[1:]), 0.5 * (y[:-1] + y[1:])
    u, v = np.meshgrid(middle_x, middle_y)
    directions = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions, angles.ravel()


def checked_poses(poses: ArrayLike) -> NDArray[np.float64]:
    """Camera poses as an array of shape (M, 4, 4).

    Raises:
        InvalidInputError: they are not rigid transforms, shape (M, 4, 4) or (4, 4).
    """
    transforms = float_array(poses, "poses")
    if transforms.shape == (4, 4):
        transforms = transforms[None]
    if transforms.ndim != 3 or transforms.shape[1:] != (4, 4):
        raise InvalidInputError("poses", f"shape {transforms.shape}, expected (M, 4, 4)")
    rotations = transforms[:, :3, :3]
    if not np.isfinite(transforms).all():
        raise InvalidInputError("poses", "hold NaN or infinity")
    error = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0)
    if error > 1e-6 or (np.linalg.det(rotations) < 0.0).any():
        raise InvalidInputError("poses", "hold a rotation that is none")
    return np.ascontiguousarray(transforms)


def checked_reach(positions: FloatArray, max_range: float, voxel_size: float) -> float:
    """`max_range` [m], if it and the positions, shape (M, 3) [m], can be looked up in a map.

    Raises:
        InvalidInputError: they cannot.
    """
    reach = np.abs(positions).max(initial=0.0) + max_range
    if not (max_range > 0.0 and reach / voxel_size < 1e6):
        raise InvalidInputError(
            "max_range", f"is {max_range} m, expected a positive range within the map's limits"
        )
    return float(max_range)


def checked_region(region: ArrayLike | None) -> FloatArray:
    """Corners (low, high) of a region, shape (2, 3) [m]; all of space without one.

    Raises:
        InvalidInputError: it is not a box (low, high), shape (2, 3).
    """
    if region is None:
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    box = float_array(region, "region")
    if box.shape != (2, 3) or np.isnan(box).any() or (box[1] < box[0]).any():
        raise InvalidInputError("region", f"is {box.tolist()}, expected (low, high) corners")
    return box


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
