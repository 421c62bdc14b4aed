"""From where fiducials were seen, and whether they look the same from elsewhere.

A viewpoint is the place of the camera in the map [m] and the direction of its image's v axis there,
shape (2, 3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray

_SAME_ANGLE, _SAME_ROLL, _SAME_SCALE = 0.35, 0.35, 1.4  # [rad, rad, 1]


def viewpoint(T_map_camera: FloatArray) -> FloatArray:
    """The viewpoint of a camera at a pose, shape (4, 4)."""
    return np.stack([T_map_camera[:3, 3], T_map_camera[:3, 1]])


def moved_viewpoint(T_new_old: FloatArray, before: FloatArray) -> FloatArray:
    """A viewpoint, shape (2, 3), in a map whose frame was put elsewhere, shape (4, 4)."""
    moved = before @ T_new_old[:3, :3].T
    moved[0] += T_new_old[:3, 3]
    return np.asarray(moved)


def look_the_same(
    points: FloatArray, before: FloatArray, T_map_camera: FloatArray
) -> NDArray[np.bool_]:
    """Whether points look about as they did: from the same side, as large, and the same way up.

    Templates and descriptors find a fiducial again anywhere only then. A camera on an arm may well
    come back upside down.

    Args:
        points: in the map, shape (N, 3) [m].
        before: from where each was seen, shape (N, 2, 3).
        T_map_camera: from where they are seen now, shape (4, 4).

    Returns:
        Shape (N,).
    """
    rays = before[:, 0] - points, T_map_camera[:3, 3] - points
    lengths = np.linalg.norm(rays[0], axis=1), np.linalg.norm(rays[1], axis=1)
    downs = _across(before[:, 1], rays[0]), _across(T_map_camera[:3, 1], rays[1])
    same = _cosines(*rays) > np.cos(_SAME_ANGLE)
    same &= _cosines(*downs) > np.cos(_SAME_ROLL)
    same &= (lengths[1] < _SAME_SCALE * lengths[0]) & (lengths[0] < _SAME_SCALE * lengths[1])
    return np.asarray(same)


def turns_since(points: FloatArray, before: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    """By how much the surroundings of points look turned in the image.

    Args:
        points: in the map, before the camera, shape (N, 3) [m].
        before: from where each was seen, shape (N, 2, 3).
        T_map_camera: from where they are seen now, shape (4, 4).

    Returns:
        From the image's u axis towards its v axis, shape (N,) [rad].
    """
    downs = _across(before[:, 1], before[:, 0] - points) @ T_map_camera[:3, :3]
    inside = (points - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]
    du = downs[:, 0] * inside[:, 2] - inside[:, 0] * downs[:, 2]
    dv = downs[:, 1] * inside[:, 2] - inside[:, 1] * downs[:, 2]
    return np.asarray(np.arctan2(-du, dv))


def _across(directions: FloatArray, rays: FloatArray) -> FloatArray:
    """What of directions is square to rays, shape (N, 3)."""
    share = (directions * rays).sum(axis=1) / np.square(rays).sum(axis=1)
    return np.asarray(directions - share[:, None] * rays)


def _cosines(first: FloatArray, second: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
    return np.asarray((first * second).sum(axis=1) / lengths)
