"""Range maps of objects among clutter, drawn by throwing many surface samples at the image."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, make_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.stereo import RangeCloud
from infomap_ros.stereo.depth_camera import DepthCameraConfig, DepthCameraSensor

CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
_SAMPLES = 250_000


class CloudView:
    """A view that has a dense range map and nothing else."""

    stamp, camera, has_cloud = 0, CAMERA, True
    image = np.zeros((480, 640), np.uint8)

    def __init__(self, cloud: RangeCloud) -> None:
        self._cloud = cloud

    def inverse_depths(self, pixels: object) -> tuple[FloatArray, FloatArray]:
        raise AssertionError("a model needs the dense map")

    def cloud(self) -> RangeCloud:
        return self._cloud


def box(size: tuple[float, float, float], middle: tuple[float, float, float] = (0, 0, 0)):
    """Triangles of a box, shape (12, 3, 3)."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2.0
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    return (corners * size + middle)[np.array(faces)]


def bracket() -> FloatArray:
    """A part like no turned copy of itself: a plate, a post, a rib and a block."""
    return np.concatenate(
        [
            box((0.24, 0.16, 0.03)),
            box((0.05, 0.05, 0.16), (0.08, 0.04, 0.08)),
            box((0.12, 0.02, 0.08), (-0.05, -0.05, 0.05)),
            box((0.06, 0.05, 0.05), (-0.08, 0.05, 0.03)),
        ]
    )


def knobbed_box(knob: float = 0.05) -> FloatArray:
    """A box with a knob on one face: its half turn differs from it in the knob alone."""
    place = (0.06, 0.03, 0.05 + 0.5 * knob)
    return np.concatenate([box((0.22, 0.16, 0.1)), box((knob, knob, knob), place)])


def on_triangles(
    triangles: FloatArray, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Points on triangles, evenly by area, and normals across them, shape (count, 3) each."""
    first, second, third = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    across = np.cross(second - first, third - first)
    areas = np.linalg.norm(across, axis=1)
    index = rng.choice(len(areas), count, p=areas / areas.sum())
    root, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    points = (1 - root) * first[index] + root * (1 - v) * second[index] + root * v * third[index]
    return points, across[index] / areas[index, None]


def some_pose(rng: np.random.Generator, distance: float = 0.8) -> FloatArray:
    """An object turned anyhow, near the middle of the image."""
    turn = Rotation.random(random_state=rng).as_matrix()
    return make_transform(turn, [*rng.uniform(-0.1, 0.1, 2), distance * rng.uniform(0.85, 1.15)])


def range_map(
    triangles: FloatArray | None, pose: FloatArray, rng: np.random.Generator, clutter: int = 6
) -> RangeCloud:
    """A noisy depth image of an object before a floor and a wall, among boxes.

    Args:
        triangles: of the object, or None for a scene without it.
        pose: ``T_camera_object``; the clutter keeps clear of it.
        clutter: number of boxes.
    """
    depth = _floor_and_wall(pose[:3, 3], rng)
    for _ in range(clutter):
        place = np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.35, 0.35), rng.uniform(0.7, 1.4)])
        turn = Rotation.random(random_state=rng).as_matrix()
        size = rng.uniform(0.06, 0.25, 3)
        if np.linalg.norm(place - pose[:3, 3]) > 0.3:
            _throw(depth, transform_points(make_transform(turn, place), box(size)), rng)
    if triangles is not None:
        _throw(depth, transform_points(pose, triangles), rng)
    sensor = DepthCameraSensor(CAMERA, DepthCameraConfig(min_depth=0.2))
    return sensor.measure(_noisy(depth, rng))


def _floor_and_wall(middle: FloatArray, rng: np.random.Generator) -> FloatArray:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(CAMERA.matrix).T
    tilt = rng.uniform(0.4, 0.9)
    up = np.array([0.0, -np.cos(tilt), -np.sin(tilt)])
    level = up @ middle - rng.uniform(0.18, 0.25)
    with np.errstate(divide="ignore"):
        floor = level / (rays @ up)
    return np.where(floor > 0.0, np.minimum(floor, middle[2] + 1.0), middle[2] + 1.0)


def _throw(depth: FloatArray, triangles: FloatArray, rng: np.random.Generator) -> None:
    """Depth of the triangles' planes on the ray of the pixel that each sample falls in."""
    points, normals = on_triangles(triangles, _SAMPLES, rng)
    ahead = points[:, 2] > 0.1
    points, normals = points[ahead], normals[ahead]
    u, v = np.rint(CAMERA.project(points)).astype(int).T
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(CAMERA.matrix).T
    facing = np.einsum("ni,ni->n", normals, rays)
    inside = (u >= 0) & (v >= 0) & (u < CAMERA.width) & (v < CAMERA.height)
    inside &= np.abs(facing) > 0.05
    z = np.einsum("ni,ni->n", normals, points)[inside] / facing[inside]
    np.minimum.at(depth, (v[inside], u[inside]), z)


def _noisy(depth: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A structured-light camera: doi:10.1109/3DIMPVT.2012.84, a share of it smooth."""
    white, rough = rng.standard_normal((2, *depth.shape))
    smooth = cv2.GaussianBlur(rough, (0, 0), 2.5) * 2.0 * np.sqrt(np.pi) * 2.5
    sigma = 0.0012 + 0.0019 * (depth - 0.4) ** 2
    noisy = depth + sigma * (np.sqrt(0.7) * white + np.sqrt(0.3) * smooth)
    return np.asarray(np.rint(noisy * 1000.0) / 1000.0, dtype=np.float32)
