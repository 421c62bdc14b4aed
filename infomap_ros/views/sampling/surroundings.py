"""The known space around the camera: where it has room, what is connected, what to look at."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from infomap_ros.geometry import PlacedSolid, points_inside
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE, OCCUPIED, UNKNOWN, OccupancyThresholds, VoxelWindow
from infomap_ros.views.sampling import space_kernels
from infomap_ros.views.situation import Situation

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
        """Path through free space from the camera to points, (N, 3) [m, map] -> (N,) [m].

        Over cells and their 26 neighbors: right within a cell and 8 %, never shorter than the
        straight line; inf where no path is known.
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
    """Shortest paths over open cells, (cx, cy, cz) bool, from one of them, (3,), in cells."""
    lengths = np.full(cells.shape, np.inf, np.float32)
    queue, queued = np.empty(cells.size, np.int64), np.zeros(cells.shape, np.bool_)
    space_kernels.path_lengths(cells, start, lengths, queue, queued)
    return lengths


_FARTHEST = 1000.0  # [m]
# The search does not widen to where it would look at more voxels than this.
_LARGEST_WINDOW = 100_000_000
_BEYOND = 1.5  # unknown space around the known box that a glance tells apart [m]


@dataclass(frozen=True)
class SurroundingsConfig:
    """Configuration of `survey`.

    Raises:
        ConfigError: a value is out of its range.
    """

    free_probability: ClassVar[float] = 0.05
    """A voxel less likely occupied is free (2 sigma; Sujan and Dubowsky 2005)."""
    surface_margin: int = setting(
        2,
        "Unknown voxels with both an occupied and a free one within this many count as free: a "
        "scan leaves the voxels right before a surface unobserved. 0 for a sensor without noise.",
        unit="voxels",
        low=0,
        high=10,
    )
    camera_radius: float = setting(
        0.1, "Radius of the ball around the camera that must be free.", unit="m", low=0.0, high=5.0
    )
    start_radius: float = setting(
        0.5,
        "So near to where the camera is, it may pass through free space narrower than that ball.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    horizon: float = setting(
        8.0,
        "Camera positions are sought so far from the present one, along each axis; twice and four "
        "times as far where nothing is found.",
        unit="m",
        low=0.1,
        high=_FARTHEST,
    )
    cell: float = setting(
        0.2,
        "Edge of the cells in which paths and things to look at are counted.",
        unit="m",
        low=0.001,
        high=100.0,
    )

    def __post_init__(self) -> None:
        check_config(self)

    @property
    def thresholds(self) -> OccupancyThresholds:
        """When a voxel is free and when occupied."""
        occupied = max(0.5, 2.0 * self.free_probability)
        return OccupancyThresholds(self.free_probability, occupied, self.surface_margin)


def survey(situation: Situation, config: SurroundingsConfig | None = None) -> Surroundings:
    """Copy the map around the camera into a window and find room, paths and things to look at."""
    settings = config or SurroundingsConfig()
    size = situation.voxel_map.config.voxel_size
    reach = math.ceil(settings.camera_radius / size)
    inner, outer, is_whole = _boxes(situation, settings, (reach + 1) * size)
    window = situation.voxel_map.window(*outer)
    states = window.states(settings.thresholds)
    camera = window.positions_of(situation.position[None])[0]
    _clear(window, states, situation.clear_space, states != OCCUPIED)
    _clear(window, states, situation.free_body)
    extent = settings.camera_radius / size + 1.0 if settings.camera_radius > 0.0 else 0.0
    _clear_camera(states, camera, extent)
    first = np.maximum(window.positions_of(inner[:1])[0], 0)
    last = np.minimum(window.positions_of(inner[1:])[0], np.array(states.shape) - 1)
    free = _padded_free(states, first, last, reach)
    has_room = _room(free, reach, settings.camera_radius / size)
    inside = tuple(slice(reach, side - reach) for side in free.shape)
    reached = _reached(free[inside], has_room, camera - first, settings.start_radius / size)
    edge = max(1, round(settings.cell / size))
    targets, gaps = _things_to_see(window, states, situation, edge)
    lengths = _path_lengths(reached, camera - first, edge)
    return Surroundings(
        window,
        states,
        first,
        has_room,
        reached,
        targets,
        situation.position,
        is_whole,
        lengths,
        gaps,
        edge,
    )


def horizons(
    situation: Situation, config: SurroundingsConfig | None = None
) -> Iterator[SurroundingsConfig]:
    """The configuration, then with twice and four times the horizon as far as that is affordable.

    Args:
        situation: what is known.
        config: with the horizon to begin with.
    """
    settings = config or SurroundingsConfig()
    yield settings
    for factor in (2.0, 4.0):
        wider = replace(settings, horizon=min(factor * settings.horizon, _FARTHEST))
        outer = _boxes(situation, wider, 0.0)[1]
        voxels = np.prod((outer[1] - outer[0]) / situation.voxel_map.config.voxel_size)
        if voxels > _LARGEST_WINDOW:
            return
        yield wider


def _boxes(
    situation: Situation, settings: SurroundingsConfig, margin: float
) -> tuple[FloatArray, FloatArray, bool]:
    """Box of the camera positions, and of all that is seen from them, (2, 3) [m, map] each.

    And whether the first holds all known space of the region.
    """
    here, size = situation.position, situation.voxel_map.config.voxel_size
    bounds = situation.voxel_map.bounds()
    known = np.stack([here, here]) if bounds is None else np.stack(bounds) * size
    known = known + np.array([[-1.0], [2.0]]) * size
    region = np.stack([situation.region.low, situation.region.high])
    grown = region + np.array([[-1.0], [1.0]]) * situation.max_range
    horizon = np.stack([here - settings.horizon, here + settings.horizon])
    whole, inner = _common(known, grown), _common(_common(horizon, known), grown)
    is_whole = bool((inner == whole).all())
    if situation.ground_height is None:
        inner[:, 2] = np.clip(inner[:, 2], *situation.heights)
    inner[0] = np.minimum(inner[0], here - margin)
    inner[1] = np.maximum(inner[1], here + margin)
    sight = np.full(3, situation.max_range)
    if situation.is_planar:
        sight[2] = size
    outer = inner + np.array([[-1.0], [1.0]]) * sight
    beyond = np.minimum(_BEYOND if _is_shared(situation) else 0.0, sight)
    outer = _common(outer, known + np.array([[-1.0], [1.0]]) * beyond)
    outer = np.stack([np.minimum(outer[0], inner[0]), np.maximum(outer[1], inner[1])])
    return inner, outer, is_whole


def _is_shared(situation: Situation) -> bool:
    """Whether teammates are about to see something, which lies in unknown space above all."""
    return any(mate.goal is not None for mate in situation.teammates)


def _common(box: FloatArray, other: FloatArray) -> FloatArray:
    """The part of a box within another one, at least a point of it."""
    return np.stack([np.clip(box[0], *other), np.clip(box[1], *other)])


def _clear(
    window: VoxelWindow,
    states: NDArray[np.uint8],
    solids: Sequence[PlacedSolid],
    where: NDArray[np.bool_] | None = None,
) -> None:
    """Set the voxels in solids to free, of them only those marked in `where` if it is given."""
    for placed in solids:
        radius = placed.solid.bounding_radius + window.voxel_size
        corners = placed.transform[:3, 3] + np.array([[-radius], [radius]])
        low, high = window.positions_of(corners)
        low, high = np.maximum(low, 0), np.minimum(high + 1, states.shape)
        if (low >= high).any():
            continue
        places = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1)
        flat = places.reshape(-1, 3)
        inside = points_inside(window.centers_of(flat), [placed], 0.5 * window.voxel_size)
        chosen = tuple(flat[inside].T)
        states[chosen] = FREE if where is None else np.where(where[chosen], FREE, states[chosen])


def _clear_camera(states: NDArray[np.uint8], camera: IntArray, radius: float) -> None:
    """Set what is unknown around the camera to free: it is there, and sees nothing so near."""
    low = np.maximum(camera - int(radius), 0)
    part = states[tuple(map(slice, low, camera + int(radius) + 1))]
    offsets = np.moveaxis(np.indices(part.shape), 0, -1) + low - camera
    part[(part == UNKNOWN) & ((offsets**2).sum(axis=-1) <= radius * radius)] = FREE
    states[tuple(camera)] = FREE


def _padded_free(
    states: NDArray[np.uint8], first: IntArray, last: IntArray, reach: int
) -> BoolArray:
    """Which voxels are free, from `reach` before `first` to `reach` behind `last`."""
    free = np.zeros(last - first + 1 + 2 * reach, np.bool_)
    low = np.maximum(first - reach, 0)
    high = np.minimum(last + reach + 1, states.shape)
    part = states[tuple(map(slice, low, high))] == FREE
    start = low - (first - reach)
    free[tuple(map(slice, start, start + part.shape))] = part
    return free


def _room(free: BoolArray, reach: int, radius: float) -> BoolArray:
    shape = np.array(free.shape) - 2 * reach
    has_room = np.empty(shape, np.bool_)
    near = np.empty(free.shape, np.int32)
    space_kernels.free_balls(free, reach, radius * radius + 1e-6, near, has_room)
    return has_room


def _reached(free: BoolArray, has_room: BoolArray, start: IntArray, radius: float) -> BoolArray:
    """Connected free space; near the camera also where there is no room for its ball."""
    passable = has_room.copy()
    low = np.maximum(start - int(radius), 0)
    high = np.minimum(start + int(radius) + 1, free.shape)
    near = tuple(map(slice, low, high))
    offsets = [(np.arange(a, b) - s) ** 2 for a, b, s in zip(low, high, start, strict=True)]
    square = offsets[0][:, None, None] + offsets[1][:, None] + offsets[2]
    passable[near] |= free[near] & (square <= radius * radius)
    connected, _ = label(passable)
    here = connected[tuple(start)]
    return np.asarray((connected == here) & (here > 0))


def _path_lengths(reached: BoolArray, start: IntArray, edge: int) -> NDArray[np.float32]:
    cells = reached
    for axis in range(3):
        cells = np.logical_or.reduceat(cells, np.arange(0, cells.shape[axis], edge), axis=axis)
    return cell_lengths(cells, start // edge)


def _things_to_see(
    window: VoxelWindow, states: NDArray[np.uint8], situation: Situation, edge: int
) -> tuple[Targets, FloatArray]:
    """What is worth looking at in the task's region, and how far it is from every cell."""
    shape = -(-np.array(states.shape) // edge)
    counts, sums = np.zeros((*shape, 2), np.int32), np.zeros((*shape, 3))
    bounds = np.stack([situation.region.low, situation.region.high])
    limits = np.clip(bounds, window.centers_of(np.zeros(3)), window.centers_of(states.shape))
    low = window.positions_of(limits[:1])[0]
    end = np.ceil(limits[1] / window.voxel_size - 1e-9).astype(np.int64) - window.first
    space_kernels.count_targets(states, edge, low, end, counts, sums)
    cells = np.nonzero(counts[..., 0])
    number = counts[..., 0][cells].astype(np.int64)
    places = window.centers_of(sums[cells] / number[:, None])
    seen = counts.any(axis=-1)
    size = edge * window.voxel_size
    gaps = distance_transform_edt(~seen) * size if seen.any() else np.full(tuple(shape), np.inf)
    return Targets(places, number), np.asarray(gaps, dtype=np.float64)
