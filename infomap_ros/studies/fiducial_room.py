"""A camera that goes round in a room of fiducials, some of which may be on a moving body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    PinholeCamera,
    invert_transform,
    make_transform,
    perturb_transform,
    transform_points,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization import FiducialObservations, MotionPrior

CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)
PIXEL_SIGMA = 0.3  # [px]
INVERSE_DEPTH_SIGMA = 0.3 / (500.0 * 0.12)  # [1/m]: 0.3 px of disparity, baseline 0.12 m
ODOMETRY = np.diag([0.01**2] * 3 + [0.005**2] * 3)
_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along x, z is up


@dataclass(eq=False)
class Room:
    """Fiducials on a ring of radius 3 to 6 m, 3 m high; a random half may move as one body.

    Attributes:
        points: true positions now, shape (N, 3) [m].
        on_body: which are on the body, shape (N,).
        step: how the body moves from image to image, about its middle, shape (4, 4).
    """

    points: FloatArray
    on_body: NDArray[np.bool_]
    step: FloatArray

    @classmethod
    def random(cls, count: int, speed: float, rng: np.random.Generator) -> Room:
        """A room of so many fiducials, whose body moves by `speed` from image to image [m]."""
        angle, radius = rng.uniform(0, 2 * np.pi, count), rng.uniform(3.0, 6.0, count)
        height = rng.uniform(-1.5, 1.5, count)
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
        direction = rng.normal(size=3)
        turn = Rotation.from_rotvec(0.1 * speed * rng.normal(size=3)).as_matrix()
        step = make_transform(turn, speed * direction / np.linalg.norm(direction))
        return cls(points, rng.random(count) < 0.5, step)

    def move_body(self) -> None:
        """Move the body on by one image."""
        body = self.points[self.on_body]
        middle = body.mean(axis=0)
        self.points[self.on_body] = transform_points(self.step, body - middle) + middle

    def observe(
        self, T_map_camera: FloatArray, most: int, balanced: bool, rng: np.random.Generator
    ) -> FiducialObservations:
        """Noisy measurements of fiducials in view.

        Args:
            T_map_camera: true pose, shape (4, 4).
            most: fiducials that are measured.
            balanced: half of them of the body.
            rng: of the noise.
        """
        inside = transform_points(invert_transform(T_map_camera), self.points)
        pixels = CAMERA.project(inside)
        last = [CAMERA.width - 1, CAMERA.height - 1]
        with np.errstate(invalid="ignore"):
            in_view = (inside[:, 2] > 0.3) & ((pixels >= 0) & (pixels <= last)).all(axis=1)
        groups = (self.on_body, ~self.on_body) if balanced else (np.ones(len(inside), bool),)
        share = most // len(groups)
        seen = np.concatenate([np.flatnonzero(in_view & group)[:share] for group in groups])
        noise = rng.normal(size=(len(seen), 3))
        return FiducialObservations(
            seen.astype(np.int64),
            pixels[seen] + PIXEL_SIGMA * noise[:, :2],
            np.full(len(seen), PIXEL_SIGMA),
            1.0 / inside[seen, 2] + INVERSE_DEPTH_SIGMA * noise[:, 2],
            np.full(len(seen), INVERSE_DEPTH_SIGMA),
        )


def circle(steps: int, turns: float) -> list[FloatArray]:
    """Poses ``T_map_camera`` on a circle of radius 1 m, looking outwards and a little ahead."""
    poses = []
    for angle in np.linspace(0.0, 2.0 * np.pi * turns, steps + 1):
        turn = Rotation.from_euler("zy", [angle + 0.3, 0.1 * np.sin(5 * angle)]).as_matrix()
        position = [np.cos(angle), np.sin(angle), 0.1 * np.sin(3 * angle)]
        poses.append(make_transform(turn @ _LEVEL, position))
    return poses


def odometry(before: FloatArray, after: FloatArray, rng: np.random.Generator) -> MotionPrior:
    """What odometry says of a motion, with errors of `ODOMETRY`."""
    error = rng.multivariate_normal(np.zeros(6), ODOMETRY)
    return MotionPrior(perturb_transform(invert_transform(before) @ after, -error), ODOMETRY)


def pose_error(true: FloatArray, estimated: FloatArray) -> FloatArray:
    """(dt, rotation vector) of docs/conventions.md, shape (6,)."""
    turned = Rotation.from_matrix(true[:3, :3] @ estimated[:3, :3].T).as_rotvec()
    return np.concatenate([true[:3, 3] - estimated[:3, 3], turned])
