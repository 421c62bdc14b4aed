"""Poses and ways of a base, seen from above."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.geometry.transforms import FloatArray


def planar_pose(T_map_base: FloatArray) -> tuple[float, float, float]:
    """x, y [m] and yaw [rad] of a pose, shape (4, 4)."""
    yaw = float(np.arctan2(T_map_base[1, 0], T_map_base[0, 0]))
    return float(T_map_base[0, 3]), float(T_map_base[1, 3]), yaw


def way_length(path: ArrayLike) -> float:
    """Length of a way through points, shape (n, 3) [m]."""
    points = np.asarray(path, dtype=np.float64)
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()) if len(points) > 1 else 0.0


def spaced(places: FloatArray, spacing: float, length: float = np.inf) -> FloatArray:
    """The first part of a way through places, (K, 2) [m], by points at most `spacing` [m] apart."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    end = min(float(along[-1]), length)
    at = np.linspace(0.0, end, math.ceil(end / spacing) + 1)
    return np.column_stack([np.interp(at, along, places[:, axis]) for axis in range(2)])
