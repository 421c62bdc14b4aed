"""Finding places for things in a world, so that a robot can pass between them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.worlds.builder import SceneBuilder
from infomap_ros.simulation.worlds.rocks import boulder
from infomap_ros.simulation.worlds.terrain import Terrain

_TRIES = 200


class Places:
    """Discs that are taken.

    Args:
        rng: source of randomness.
        gap: free way between two discs [m].
    """

    def __init__(self, rng: np.random.Generator, gap: float) -> None:
        self._rng, self._gap = rng, gap
        self._taken: list[tuple[float, float, float]] = []

    def take(self, x: float, y: float, radius: float) -> None:
        """Mark a disc as taken [m]."""
        self._taken.append((x, y, radius))

    def find(
        self, low: tuple[float, float], high: tuple[float, float], radius: float, disc: float = 0.0
    ) -> tuple[float, float] | None:
        """Find and take a free disc with its center in a rectangle.

        Args:
            low: corner of the rectangle [m].
            high: opposite corner [m].
            radius: of the disc [m].
            disc: if not 0, the disc must lie within this radius about the origin too [m].

        Returns:
            The center, or None where no free one was found.
        """
        for _ in range(_TRIES):
            x, y = (float(value) for value in self._rng.uniform(low, high))
            if disc and np.hypot(x, y) + radius > disc:
                continue
            if all(np.hypot(x - a, y - b) >= radius + r + self._gap for a, b, r in self._taken):
                self.take(x, y, radius)
                return x, y
        return None


def upright(x: float, y: float, z: float, yaw: float, tilt: float = 0.0) -> FloatArray:
    """A pose at a place [m], turned by yaw and then tilted forward [rad]; shape (4, 4)."""
    return make_transform(Rotation.from_euler("ZY", (yaw, tilt)).as_matrix(), (x, y, z))


def add_boulder(
    builder: SceneBuilder,
    name: str,
    place: tuple[float, float],
    extent: float,
    rng: np.random.Generator,
    detail: int = 4,
) -> None:
    """Lay a boulder of about `extent` [m] on the ground, its lower part below."""
    size = extent * rng.uniform((0.85, 0.85, 0.7), (1.1, 1.1, 1.0))
    mesh = boulder((size[0], size[1], size[2]), rng, detail)
    ground = float(builder.terrain.height(place))
    pose = upright(*place, ground + 0.2 * float(size[2]), float(rng.uniform(-np.pi, np.pi)))
    builder.add_mesh(name, *mesh, pose, f"rock_{rng.integers(3)}")


def bounded_terrain(
    half: float, floor: FloatArray, edge: FloatArray, height: float, width: float
) -> Terrain:
    """Ground that rises to a rim.

    Args:
        half: half the edge length of the square ground [m].
        floor: heights of the ground without the rim, shape (n, n) [m].
        edge: distance of each node beyond the foot of the rim, negative inside, shape (n, n) [m].
        height: of the rim [m].
        width: over which it rises [m].

    Returns:
        The terrain; its height at the origin is zero.
    """
    share = np.clip(edge / width, 0.0, 1.0)
    heights = floor + height * share**1.3
    middle = len(floor) // 2
    return Terrain(heights - heights[middle, middle], half)
