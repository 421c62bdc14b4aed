"""Boulders: spheres cut by random planes and roughened, as vertices and faces."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from infomap_ros.geometry.transforms import FloatArray

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
