"""A camera without a body that flies, but only through space that is known to be free."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE, OccupancyThresholds, VoxelMap
from infomap_ros.views.reach import Flight
from infomap_ros.views.sampling import flight_kernels
from infomap_ros.views.sampling.surroundings import cell_lengths

NO_WAY = "no way through known free space"


class FreeFlight:
    """Reaches every view to which a way leads through known free voxels; tells that way.

    The way is the shortest one over the voxels and their neighbors, then pulled straight. For a
    robot without a body, as the sensors of Figs. 10 to 14 of Sujan and Dubowsky (2005,
    doi:10.1177/0278364905051774); a `Reachability`.

    Args:
        voxel_map: what is known; must not change while views are asked for.
        T_map_camera: where the camera is, shape (4, 4).
        heights: lowest and highest z of the way [m, map].
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
        """Nothing speaks against any view, shape (M, 4, 4), before a way is sought."""
        return [""] * len(poses)

    def reach(self, T_map_camera: FloatArray) -> Flight:
        """The way to one view, shape (4, 4); its route holds the corners (N, 3) [m, map]."""
        corners = self.way_to(np.asarray(T_map_camera[:3, 3]))
        if corners is None:
            return Flight(reason=NO_WAY)
        travel = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())
        return Flight(travel=travel, route=corners)

    def way_to(self, place: FloatArray) -> FloatArray | None:
        """Corners of the way to a place, shape (3,) [m, map] -> (N, 3); None where none leads."""
        size, first = self._window.voxel_size, self._window.first
        goal = self._window.positions_of(place[None])
        if not (self._window.contains(goal)[0] and self._open[tuple(goal[0])]):
            return None
        start, end = self._start / size - first, place / size - first
        if flight_kernels.is_open_line(self._open, start, end):
            return np.stack([self._start, place])
        if self._lengths is None:
            self._lengths = cell_lengths(self._open, self._here)
        if not np.isfinite(self._lengths[tuple(goal[0])]):
            return None
        voxels = np.empty((self._open.size, 3), np.int64)
        count = flight_kernels.descend(self._lengths, goal[0], voxels)
        way = np.concatenate([start[None], voxels[: count - 1][::-1] + 0.5, end[None]])
        kept = np.empty(len(way), np.int64)
        count = flight_kernels.shorten(self._open, way, kept)
        return np.asarray((way[kept[:count]] + first) * size)
