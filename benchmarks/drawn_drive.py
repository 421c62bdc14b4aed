"""A drive through a drawn rock field whose fiducials have an exactly known place.

Pairs of 640x480 px are drawn at twice that size and averaged, then exposed with shot and read
noise. The depth image of the renderer tells where the point of any pixel lies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    PinholeCamera,
    StereoRig,
    invert_transform,
    make_transform,
    transform_points,
)
from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.worlds.scenes import make_world
from infomap_ros.stereo import StereoRangeSensor

WIDTH, HEIGHT, FOCAL, BASELINE = 640, 480, 420.0, 0.1016
CAMERA = PinholeCamera(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
SENSOR = StereoRangeSensor(StereoRig(CAMERA, CAMERA, BASELINE))
_FINE = CAMERA.scaled(2.0)
_ELECTRONS, _READ_NOISE = 9000.0 / 255.0, 14.0  # per gray level; electrons
_EDGE = 0.08  # depth range about a point, as a share of the depth, that makes it a depth edge

Disturbance = Callable[[np.ndarray, int], np.ndarray]
"""The light of an image and its number -> the light that the camera gets."""


def unchanged(light: np.ndarray, _: int) -> np.ndarray:
    """No disturbance."""
    return light


@dataclass(frozen=True, eq=False)
class Moment:
    """What was drawn from one pose."""

    pose: np.ndarray
    left: np.ndarray
    right: np.ndarray
    inverse_depth: np.ndarray  # twice as fine as the images

    def inverse_depths(self, pixels: np.ndarray) -> np.ndarray:
        """True 1/z at pixels, shape (N,); NaN in the sky, on depth edges and outside."""
        if len(pixels) == 0:
            return np.zeros(0)
        fine = self.inverse_depth
        places = 2.0 * pixels + 0.5
        inside = ((places > 4) & (places < np.array(fine.shape[::-1]) - 6)).all(axis=1)
        places = np.where(inside[:, None], places, 10.0)
        u, v = (places[:, i : i + 1].astype(np.float32) for i in (0, 1))
        value = cv2.remap(fine, u, v, cv2.INTER_LINEAR)[:, 0].astype(float)
        near = np.rint(places).astype(int)[:, :, None] + np.arange(-4, 5)
        window = fine[near[:, 1, :, None], near[:, 0, None, :]]
        smooth = np.ptp(window, axis=(1, 2)) < _EDGE * value
        return np.where(inside & smooth, value, np.nan)

    def points(self, pixels: np.ndarray) -> np.ndarray:
        """Points in the world, shape (N, 3) [m]; NaN likewise."""
        depth = 1.0 / self.inverse_depths(pixels)
        across = (pixels - [CAMERA.cx, CAMERA.cy]) / FOCAL
        return transform_points(
            self.pose, np.column_stack([across, np.ones(len(depth))]) * depth[:, None]
        )

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels of points in the world, shape (N, 2)."""
        return CAMERA.project(transform_points(invert_transform(self.pose), points))

    def sees(self, points: np.ndarray) -> np.ndarray:
        """Which points are well inside the image and not hidden, shape (N,)."""
        inside = transform_points(invert_transform(self.pose), points)
        pixels = CAMERA.project(inside)
        with np.errstate(invalid="ignore"):
            well = ((pixels > 15) & (pixels < [WIDTH - 16, HEIGHT - 16])).all(axis=1)
        inverse = self.inverse_depths(np.where(well[:, None], pixels, 0.0))
        return well & (np.abs(inverse * inside[:, 2] - 1.0) < 0.03)

    def view(self, stamp: int, disturb: Disturbance, rng: np.random.Generator) -> StereoView:
        """What the cameras measure."""
        images = []
        for light in (self.left, self.right):
            electrons = _ELECTRONS * np.clip(disturb(light.astype(float), stamp), 0.0, None)
            noisy = rng.normal(electrons, np.sqrt(electrons + _READ_NOISE**2)) / _ELECTRONS
            images.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
        return StereoView(stamp, images[0], images[1], SENSOR)


def draw(count: int, step: float, turn: float, seed: int) -> list[Moment]:
    """Draw a drive of `count` steps of `step` [m] and `turn` [rad] and a swaying camera."""
    world = make_world("rover_rocks", seed)
    data = world.new_data()
    ground = float(world.terrain.height(np.zeros((1, 2)))[0])
    moments = []
    with Renderer(world.model, _FINE.width, _FINE.height) as renderer:
        for pose in _trajectory(count, step, turn, ground, np.random.default_rng(seed)):
            right = pose @ make_transform(np.eye(3), [BASELINE, 0.0, 0.0])
            images = [
                cv2.resize(
                    cv2.cvtColor(renderer.color(data, eye, _FINE), cv2.COLOR_RGB2GRAY),
                    (WIDTH, HEIGHT),
                    interpolation=cv2.INTER_AREA,
                )
                for eye in (pose, right)
            ]
            depth = renderer.depth(data, pose, _FINE)
            moments.append(Moment(pose, images[0], images[1], 1.0 / depth))
    return moments


def _trajectory(
    count: int, step: float, turn: float, ground: float, rng: np.random.Generator
) -> list[np.ndarray]:
    k = np.arange(count)
    yaw = 0.3 * np.sin(k * turn / 0.3) + rng.normal(0.0, 0.003, count)
    pitch = 0.35 + 0.05 * np.sin(0.2 * k) + rng.normal(0.0, 0.003, count)
    roll = 0.04 * np.sin(0.3 * k) + rng.normal(0.0, 0.003, count)
    x, y = -1.0 + np.cumsum(np.cos(yaw)) * step, np.cumsum(np.sin(yaw)) * step
    z = ground + 0.55 + 0.05 * np.sin(0.15 * k) + rng.normal(0.0, 0.002, count)
    optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    turns = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll])).as_matrix()
    return [make_transform(turns[i] @ optical, [x[i], y[i], z[i]]) for i in k]
