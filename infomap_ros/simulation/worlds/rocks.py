"""Boulders: spheres cut by random planes and roughened, as vertices and faces.

Finding places for things in a world, so that a robot can pass between them.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.worlds.builder import SceneBuilder
from infomap_ros.simulation.worlds.terrain import Terrain

Mesh = tuple[FloatArray, NDArray[np.int64]]


def boulder(size: tuple[float, float, float], rng: np.random.Generator, detail: int = 4) -> Mesh:
    """Make one boulder about the origin.

    Args:
        size: approximate extent along x, y, z [m].
        rng: source of randomness.
        detail: subdivisions of the icosahedron; 4 gives 2562 vertices.

    Returns:
        Vertices, shape (V, 3) [m], and outward faces, shape (F, 3).
    """
    directions, faces = icosphere(detail)
    radius = _facets(directions, rng) * (1.0 + _bumps(directions, rng))
    return 0.5 * np.asarray(size) * directions * radius[:, None], faces


def _facets(directions: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Radius of a unit sphere cut by random planes, edges slightly rounded; shape (V,)."""
    normals = rng.standard_normal((14, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = rng.uniform(0.62, 0.95, 14)
    cosine = np.maximum(directions @ normals.T, 1e-3)
    inverse = np.concatenate([cosine / offsets, np.ones((len(directions), 1))], axis=1)
    softness = 40.0
    return np.asarray(softness / np.log(np.exp(softness * inverse).sum(axis=1)))


def _bumps(directions: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Sum of random waves, amplitude falling with frequency; shape (V,)."""
    total = np.zeros(len(directions))
    for frequency in (3.0, 6.0, 12.0, 22.0):
        waves = rng.standard_normal((8, 3)) * frequency
        phases = rng.uniform(0.0, 2.0 * np.pi, 8)
        total += 0.06 / frequency * np.sin(directions @ waves.T + phases).sum(axis=1)
    return total


@functools.cache
def icosphere(detail: int) -> Mesh:
    """Unit sphere of almost equal triangles: vertices (V, 3) and outward faces (F, 3)."""
    golden = 0.5 * (1.0 + 5.0**0.5)
    corners = [(0.0, a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    vertices = np.array([np.roll(corner, shift) for corner in corners for shift in range(3)])
    vertices /= np.linalg.norm(vertices[0])
    faces = _outward(vertices, ConvexHull(vertices).simplices.astype(np.int64))
    for _ in range(detail):
        vertices, faces = _subdivide(vertices, faces)
    return vertices, faces


def _outward(vertices: FloatArray, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0.0
    return np.where(inward[:, None], faces[:, ::-1], faces)


def _subdivide(vertices: FloatArray, faces: NDArray[np.int64]) -> Mesh:
    """Cut every triangle into four and push the new vertices onto the unit sphere."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    middles = vertices[unique].mean(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    ab, bc, ca = index.reshape(3, -1) + len(vertices)
    a, b, c = faces.T
    finer = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    stacked = np.concatenate([np.stack(corner, axis=1) for corner in finer])
    return np.concatenate([vertices, middles]), stacked


_TRIES = 200


class Places:
    """Discs that are taken.

    Args:
        rng: source of randomness.
        gap: free distance between two discs [m].
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
