"""Triangles out of files of meshes."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray


def read_triangles(path: str | Path, scale: float = 1.0) -> FloatArray:
    """Corners of the triangles of a mesh in any format that Assimp knows, shape (F, 3, 3).

    Args:
        path: .stl, .obj, .dae, .ply, .glb and others.
        scale: meters per unit of the file.

    Raises:
        InvalidInputError: it cannot be read, or holds no triangles.
    """
    try:
        mesh = coal.MeshLoader().load(str(path), np.full(3, scale))
    except (ValueError, RuntimeError) as error:
        raise InvalidInputError("mesh", f"{path} cannot be read ({error})") from error
    faces = np.array([[t[0], t[1], t[2]] for t in map(mesh.tri_indices, range(mesh.num_tris))])
    if not len(faces):
        raise InvalidInputError("mesh", f"{path} holds no triangles")
    return np.asarray(np.asarray(mesh.vertices(), dtype=np.float64)[faces])
