"""Scenes with known surfaces, ray cast analytically."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from infomap_ros.geometry import PinholeCamera, make_transform


@dataclass(frozen=True)
class Scene:
    """Surfaces in the map frame.

    Attributes:
        planes: (nx, ny, nz, offset) with ``n . x = offset`` [m].
        spheres: (x, y, z, radius) [m].
        poles: vertical cylinders of endless height, (x, y, radius) [m].
    """

    planes: list[tuple[float, ...]] = field(default_factory=list)
    spheres: list[tuple[float, ...]] = field(default_factory=list)
    poles: list[tuple[float, ...]] = field(default_factory=list)

    def first_hit(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Smallest positive t with origin + t direction on a surface, inf where there is none."""
        nearest = np.full(np.broadcast_shapes(origins.shape, directions.shape)[:-1], np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            for *normal, offset in self.planes:
                t = (offset - origins @ np.array(normal)) / (directions @ np.array(normal))
                nearest = np.where((t > 0.0) & (t < nearest), t, nearest)
        for x, y, z, radius in self.spheres:
            t = _round_hit(origins - np.array([x, y, z]), directions, radius)
            nearest = np.minimum(nearest, t)
        for x, y, radius in self.poles:
            t = _round_hit(origins[..., :2] - np.array([x, y]), directions[..., :2], radius)
            nearest = np.minimum(nearest, t)
        return nearest

    def points(self, camera: PinholeCamera, T_map_camera: np.ndarray) -> np.ndarray:
        """What the camera measures, shape (H, W, 3), float32, camera frame [m]; NaN for nothing."""
        rays = camera.back_project(np.ones((camera.height, camera.width))).astype(np.float64)
        depth = self.first_hit(T_map_camera[:3, 3], rays @ T_map_camera[:3, :3].T)
        return (rays * np.where(np.isfinite(depth), depth, np.nan)[..., None]).astype(np.float32)


def _round_hit(offset: np.ndarray, direction: np.ndarray, radius: float) -> np.ndarray:
    a = (direction**2).sum(axis=-1)
    b = (offset * direction).sum(axis=-1)
    c = (offset**2).sum(axis=-1) - radius**2
    root = b * b - a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (-b - np.sqrt(root)) / a
    return np.where((root > 0.0) & (t > 0.0), t, np.inf)


def look_at(position: np.ndarray, target: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """T_map_camera of an optical frame at `position` that looks at `target`, z of the map up."""
    forward = np.asarray(target, float) - np.asarray(position, float)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    x = np.cos(roll) * right + np.sin(roll) * down
    return make_transform(np.stack([x, np.cross(forward, x), forward], axis=1), position)


def random_scene(rng: np.random.Generator) -> Scene:
    """A closed room of about 3 m with a few balls and a pole."""
    planes = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = np.eye(3)[axis] * sign + rng.normal(0.0, 0.1, 3)
            normal /= np.linalg.norm(normal)
            planes.append((*normal, float(rng.uniform(1.2, 2.0))))
    balls = [
        (*rng.uniform(-1.0, 1.0, 3), float(rng.uniform(0.1, 0.3))) for _ in range(rng.integers(4))
    ]
    return Scene(planes, balls, [(*rng.uniform(-1.0, 1.0, 2), 0.05)])


def random_pose(rng: np.random.Generator, spread: float = 0.3) -> np.ndarray:
    """A camera near the middle of the room with any rotation."""
    return look_at(rng.uniform(-spread, spread, 3), rng.normal(size=3) * 2.0, rng.uniform(-3, 3))


def with_holes(points: np.ndarray, rng: np.random.Generator, share: float) -> np.ndarray:
    """The same image with unmeasured pixels, single ones and whole patches."""
    holes = rng.random(points.shape[:2]) < share / 2
    height, width = holes.shape
    while holes.mean() < share:
        v, u = rng.integers(height), rng.integers(width)
        holes[v : v + rng.integers(1, 9), u : u + rng.integers(1, 9)] = True
    return np.where(holes[..., None], np.float32(np.nan), points)
