"""A camera without a body that flies, but only through space that is known to be free."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE, OccupancyThresholds, VoxelMap
from infomap_ros.views.sampling.surroundings import cell_lengths

NO_PATH = "no path through known free space"


@dataclass(frozen=True)
class Flight:
    """The `ReachResult` of a camera that flies."""

    reason: str = ""
    travel: float = 0.0
    route: object | None = None
    partial: bool = False
    seconds: float = float("nan")


class FlyingCamera:
    """A camera without a body: it reaches every view that the map allows, as in Figs. 10 to 12."""

    def __init__(self, T_map_camera: FloatArray) -> None:
        """Start at a pose, shape (4, 4)."""
        self._position = np.array(T_map_camera[:3, 3])

    def may_reach(self, poses: FloatArray) -> Sequence[str]:
        """Nothing speaks against any view, shape (M, 4, 4)."""
        return [""] * len(poses)

    def reach(self, T_map_camera: FloatArray) -> Flight:
        """Fly straight there, shape (4, 4)."""
        return Flight(travel=float(np.linalg.norm(T_map_camera[:3, 3] - self._position)))


class FreeFlight:
    """Reaches every view to which a path leads through known free voxels, and gives the path.

    The path is the shortest one over the voxels and their neighbors, then pulled straight. For a
    robot without a body, as the sensors of Figs. 10 to 14 of Sujan and Dubowsky (2005,
    doi:10.1177/0278364905051774); a `Reachability`.

    Args:
        voxel_map: what is known; must not change while views are asked for.
        T_map_camera: where the camera is, shape (4, 4).
        heights: lowest and highest z of the path [m, map].
        thresholds: when a voxel is free.
    """

    def __init__(
        self,
        voxel_map: VoxelMap,
        T_map_camera: FloatArray,
        heights: tuple[float, float] = (-np.inf, np.inf),
        thresholds: OccupancyThresholds | None = None,
    ) -> None:
        self._start = np.array(T_map_camera[:3, 3])
        size, bounds = voxel_map.config.voxel_size, voxel_map.bounds()
        known = np.stack([self._start, self._start])
        if bounds is not None:
            known = np.stack([bounds[0] * size, (bounds[1] + 1) * size])
            known = np.stack([np.minimum(known[0], self._start), np.maximum(known[1], self._start)])
        known[:, 2] = np.clip(known[:, 2], *heights)
        self._window = voxel_map.window(*known)
        self._open = self._window.states(thresholds) == FREE
        self._here = self._window.positions_of(self._start[None])[0]
        self._open[tuple(self._here)] = True
        self._lengths: NDArray[np.float32] | None = None

    def may_reach(self, poses: FloatArray) -> Sequence[str]:
        """Nothing speaks against any view, shape (M, 4, 4), before a path is sought."""
        return [""] * len(poses)

    def reach(self, T_map_camera: FloatArray) -> Flight:
        """The path to one view, shape (4, 4); its route holds the corners (N, 3) [m, map]."""
        corners = self.path_to(np.asarray(T_map_camera[:3, 3]))
        if corners is None:
            return Flight(reason=NO_PATH)
        travel = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())
        return Flight(travel=travel, route=corners)

    def path_to(self, place: FloatArray) -> FloatArray | None:
        """Corners of the path to a place, shape (3,) [m, map] -> (N, 3); None where none leads."""
        size, first = self._window.voxel_size, self._window.first
        goal = self._window.positions_of(place[None])
        if not (self._window.contains(goal)[0] and self._open[tuple(goal[0])]):
            return None
        start, end = self._start / size - first, place / size - first
        if is_open_line(self._open, start, end):
            return np.stack([self._start, place])
        if self._lengths is None:
            self._lengths = cell_lengths(self._open, self._here)
        if not np.isfinite(self._lengths[tuple(goal[0])]):
            return None
        voxels = np.empty((self._open.size, 3), np.int64)
        count = descend(self._lengths, goal[0], voxels)
        path = np.concatenate([start[None], voxels[: count - 1][::-1] + 0.5, end[None]])
        kept = np.empty(len(path), np.int64)
        count = shorten(self._open, path, kept)
        return np.asarray((path[kept[:count]] + first) * size)


_SAMPLES = 4  # per voxel along a straight line


@njit(cache=True, nogil=True)
def descend(lengths: Any, goal: Any, path: Any) -> int:
    """Follow the lengths of shortest paths from a voxel back to where they are 0.

    Args:
        lengths: of `space_kernels.path_lengths`, shape (nx, ny, nz).
        goal: position of the voxel, shape (3,); its length is finite.
        path: receives the positions from the goal to the start, shape (n, 3), n large enough.

    Returns:
        Number of positions.
    """
    nx, ny, nz = lengths.shape
    x, y, z = goal[0], goal[1], goal[2]
    count = 0
    while True:
        path[count, 0], path[count, 1], path[count, 2] = x, y, z
        count += 1
        best, bx, by, bz = lengths[x, y, z], x, y, z
        least = np.inf
        for a in range(max(0, x - 1), min(nx, x + 2)):
            for b in range(max(0, y - 1), min(ny, y + 2)):
                for c in range(max(0, z - 1), min(nz, z + 2)):
                    square = (a - x) * (a - x) + (b - y) * (b - y) + (c - z) * (c - z)
                    length = lengths[a, b, c] + math.sqrt(square)
                    if lengths[a, b, c] < best and length < least:
                        least, bx, by, bz = length, a, b, c
        if least == np.inf or count == len(path):
            return count
        x, y, z = bx, by, bz


@njit(cache=True, nogil=True)
def is_open_line(open_voxels: Any, start: Any, end: Any) -> bool:
    """Whether the straight line between two places, shape (3,) [voxels], stays in open voxels.

    Sampled four times per voxel: a corner that is cut by less is not seen.
    """
    nx, ny, nz = open_voxels.shape
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    steps = int(math.sqrt(dx * dx + dy * dy + dz * dz) * _SAMPLES) + 1
    for i in range(steps + 1):
        share = i / steps
        x = math.floor(start[0] + share * dx)
        y = math.floor(start[1] + share * dy)
        z = math.floor(start[2] + share * dz)
        if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
            return False
        if not open_voxels[x, y, z]:
            return False
    return True


@njit(cache=True, nogil=True)
def shorten(open_voxels: Any, path: Any, kept: Any) -> int:
    """Replace a path by straight lines: from each place on to the farthest one in a line.

    Args:
        open_voxels: shape (nx, ny, nz), bool.
        path: places [voxels], shape (n, 3).
        kept: receives the indices of the places that are left, shape (n,).

    Returns:
        Their number.
    """
    kept[0], count, here = 0, 1, 0
    while here < len(path) - 1:
        far = len(path) - 1
        while far > here + 1 and not is_open_line(open_voxels, path[here], path[far]):
            far -= 1
        here = far
        kept[count] = here
        count += 1
    return count
