"""Depth images taken over to the color camera beside the depth camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera, make_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True, eq=False)
class ColorCamera:
    """The color camera of a depth camera, parallel to it.

    Attributes:
        camera: its undistorted image.
        offset: of a point's coordinates, from the depth camera's to this one's, (x, y, z) [m].
    """

    camera: PinholeCamera
    offset: tuple[float, float, float]

    @property
    def T_color_depth(self) -> FloatArray:
        """Takes points in the depth camera's frame to this one's, shape (4, 4)."""
        return make_transform(np.eye(3), self.offset)


def register_depth(
    depth: NDArray[np.uint16], camera: PinholeCamera, color: ColorCamera
) -> NDArray[np.uint16]:
    """The depth image that the color camera would have seen.

    Args:
        depth: shape (H, W) [mm], 0 where not measured.
        camera: of the depth image.
        color: where it is to be seen from.

    Returns:
        Shape of the color image [mm]; of several points in one pixel the nearest.
    """
    v, u = np.nonzero(depth)
    z = 1e-3 * depth[v, u].astype(np.float64)
    rays = np.column_stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))]
    )
    points = transform_points(color.T_color_depth, rays * z[:, None])
    pixels = np.rint(color.camera.project(points))
    size = [color.camera.width, color.camera.height]
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < size)).all(axis=1)
    columns, rows = pixels[inside].astype(np.int64).T
    seen = np.rint(1e3 * points[inside, 2]).astype(np.uint16)
    result = np.full(size[::-1], np.iinfo(np.uint16).max, np.uint16)
    np.minimum.at(result, (rows, columns), seen)
    result[result == np.iinfo(np.uint16).max] = 0
    return result
