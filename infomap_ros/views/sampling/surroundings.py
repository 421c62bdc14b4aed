"""The known space around the camera: where it has room, what is connected, what to look at."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelWindow
from infomap_ros.views.sampling import space_kernels

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Targets:
    """Where there is something to look at: one entry per cell.

    Attributes:
        places: mean position of the cell's voxels, shape (T, 3) [m, map].
        counts: how many they are, shape (T,).
    """

    places: FloatArray
    counts: IntArray


@dataclass(frozen=True, eq=False)
class Surroundings:
    """A dense window of the map around the camera, and what the choice asks of it.

    Attributes:
        window: the voxels that may be passed or seen.
        states: of these voxels, the robot's own body counted as free.
        first: position in the window of the box in which camera positions are sought, shape (3,).
        has_room: whether the camera's ball is free, in that box.
        reached: whether the camera gets there through connected free space, in that box.
        targets: what is worth looking at.
        position: of the camera, shape (3,) [m, map].
        is_whole: the box holds all known space of the region; else the horizon has cut it.
    """

    window: VoxelWindow
    states: NDArray[np.uint8]
    first: IntArray
    has_room: BoolArray
    reached: BoolArray
    targets: Targets
    position: FloatArray
    is_whole: bool
    _lengths: NDArray[np.float32]
    _gaps: FloatArray
    _edge: int

    @property
    def voxel_size(self) -> float:
        """Edge of a voxel [m]."""
        return self.window.voxel_size

    def in_box(self, points: FloatArray) -> tuple[IntArray, BoolArray]:
        """Positions of points, (N, 3) [m, map], in the box (N, 3), and which are in it (N,)."""
        places = np.asarray(self.window.positions_of(points) - self.first)
        inside = (places >= 0) & (places < self.reached.shape)
        return places, np.asarray(inside.all(axis=1))

    def states_at(self, points: FloatArray) -> NDArray[np.uint8]:
        """State of the voxels at points, (N, 3) [m, map] -> (N,); unknown beyond the window."""
        places = self.window.positions_of(points)
        inside = self.window.contains(places)
        states = np.zeros(len(places), np.uint8)
        states[inside] = self.states[tuple(places[inside].T)]
        return states

    def centers(self, flat: IntArray) -> FloatArray:
        """Centers of voxels given by their flat index in the box, (N,) -> (N, 3) [m, map]."""
        places = np.stack(np.unravel_index(flat, self.reached.shape), axis=1)
        return self.window.centers_of(places + self.first)

    def reached_near(self, radius: float) -> IntArray:
        """Flat indices in the box of what is reached within `radius` [m] of the camera."""
        middle = self.window.positions_of(self.position[None])[0] - self.first
        reach = radius / self.voxel_size
        low = np.maximum(middle - int(reach), 0)
        high = np.minimum(middle + int(reach) + 1, self.reached.shape)
        places = np.argwhere(self.reached[tuple(map(slice, low, high))]) + low
        places = places[((places - middle) ** 2).sum(axis=1) <= reach * reach]
        return np.ravel_multi_index(tuple(places.T), self.reached.shape)

    def path_lengths(self, points: FloatArray) -> FloatArray:
        """Way through free space from the camera to points, (N, 3) [m, map] -> (N,) [m].

        Over cells and their 26 neighbors: right within a cell and 8 %, never shorter than the
        straight line; inf where no way is known.
        """
        places, inside = self.in_box(points)
        lengths = np.full(len(points), np.inf)
        cells = places[inside] // self._edge
        lengths[inside] = self._lengths[tuple(cells.T)] * (self._edge * self.voxel_size)
        straight = np.linalg.norm(points - self.position, axis=1)
        return np.asarray(np.maximum(lengths - self._edge * self.voxel_size, straight))

    def path_lengths_from(self, start: FloatArray, points: FloatArray) -> FloatArray:
        """The same from any place, shape (3,) [m, map], to points (N, 3): (N,) [m]."""
        place, inside = self.in_box(start[None])
        if not inside[0]:
            return np.full(len(points), np.inf)
        lengths = cell_lengths(np.isfinite(self._lengths), place[0] // self._edge)
        return replace(self, position=start, _lengths=lengths).path_lengths(points)

    def gaps(self, points: FloatArray) -> FloatArray:
        """Distance from points, (N, 3) [m, map], to what may be looked at, (N,) [m], by cells.

        That is the periphery of the known, uncertain voxels and obstacles; inf beyond the window.
        """
        places = self.window.positions_of(points)
        inside = self.window.contains(places)
        gaps = np.full(len(points), np.inf)
        gaps[inside] = self._gaps[tuple((places[inside] // self._edge).T)]
        return gaps


def cell_lengths(cells: BoolArray, start: IntArray) -> NDArray[np.float32]:
    """Shortest ways over open cells, (cx, cy, cz) bool, from one of them, (3,), in cells."""
    lengths = np.full(cells.shape, np.inf, np.float32)
    queue, queued = np.empty(cells.size, np.int64), np.zeros(cells.shape, np.bool_)
    space_kernels.path_lengths(cells, start, lengths, queue, queued)
    return lengths
