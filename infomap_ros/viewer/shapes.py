"""Shapes that several layers of the page draw.

Colors of the page: the same maps as in the report of a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from infomap_ros.geometry import Box, Cylinder, PinholeCamera, Sphere
from infomap_ros.geometry.transforms import FloatArray, quaternion_from_transform
from infomap_ros.motion.robot.body_shapes import BodyShape

Color = tuple[int, int, int]

_OPENING = 0.25  # of a camera, as it is drawn [m]


def frustum(scene: Any, name: str, camera: PinholeCamera | None, color: Color) -> Any:
    """A camera at the origin, to be placed; a common one where `camera` is None."""
    height, width, focal = 3.0, 4.0, 3.0
    if camera is not None:
        height, width, focal = float(camera.height), float(camera.width), camera.fy
    opening = 2.0 * float(np.arctan2(0.5 * height, focal))
    return scene.add_camera_frustum(name, opening, width / height, scale=_OPENING, color=color)


def draw_path(
    scene: Any,
    name: str,
    points: Sequence[FloatArray] | FloatArray,
    color: Color,
    width: float = 3.0,
) -> None:
    """Draw a line along points, shape (N, 3) [m, map]; nothing where there are less than two."""
    path = np.asarray(points, dtype=np.float32).reshape(-1, 3)
    ends = np.stack([path[:-1], path[1:]], axis=1) if len(path) > 1 else np.zeros((1, 2, 3))
    line = scene.add_line_segments(name, ends, color, thickness=width, thickness_units="screen")
    line.visible = len(path) > 1


def place(handle: Any, transform: FloatArray) -> None:
    """Put something to a pose, shape (4, 4)."""
    x, y, z, w = quaternion_from_transform(transform)
    handle.wxyz, handle.position = (w, x, y, z), tuple(transform[:3, 3])


def draw_solid(scene: Any, name: str, shape: BodyShape, color: Color) -> Any:
    """A collision shape at the origin, to be placed; of a mesh its convex hull."""
    solid = shape.solid
    if isinstance(solid, Box):
        return scene.add_box(name, color, solid.size)
    if isinstance(solid, Cylinder):
        return scene.add_cylinder(name, solid.radius, solid.length, color)
    if isinstance(solid, Sphere):
        return scene.add_icosphere(name, solid.radius, color)
    vertices = shape.vertices
    assert vertices is not None  # what is no plain shape is a mesh
    hull = ConvexHull(vertices)
    inward = np.einsum("ij,ij->i", hull.equations[:, :3], _facet_normals(vertices, hull.simplices))
    faces = np.where((inward < 0.0)[:, None], hull.simplices[:, ::-1], hull.simplices)
    return scene.add_mesh_simple(name, vertices, faces, color=color, flat_shading=True)


def _facet_normals(vertices: FloatArray, faces: FloatArray) -> FloatArray:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.asarray(np.cross(b - a, c - a))


ROBOT, BASE_PATH, CAMERA_PATH = (96, 108, 120), (213, 94, 0), (0, 114, 178)
CHOSEN, REJECTED, PLACE = (220, 50, 32), (150, 156, 163), (204, 121, 167)
TEAM = ((31, 119, 180), (255, 127, 14), (44, 160, 44), (148, 103, 189))
"""Of robots by their ids, one after the other."""


def colored(values: FloatArray, low: float, high: float, name: str) -> NDArray[np.uint8]:
    """Colors of values on a color map of matplotlib.

    Args:
        values: shape (N,).
        low: value of the first color.
        high: value of the last color.
        name: of the color map.

    Returns:
        Shape (N, 3), red, green, blue.
    """
    shares = np.clip((np.asarray(values) - low) / max(high - low, 1e-12), 0.0, 1.0)
    return np.asarray(np.rint(255.0 * matplotlib.colormaps[name](shares)[:, :3]), dtype=np.uint8)


def gradient(name: str) -> str:
    """A color map as a gradient of CSS, from left to right."""
    stops = colored(np.linspace(0.0, 1.0, 9), 0.0, 1.0, name)
    return "linear-gradient(to right, " + ", ".join(f"rgb{tuple(map(int, s))}" for s in stops) + ")"
