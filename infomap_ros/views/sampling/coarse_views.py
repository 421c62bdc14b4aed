"""What a few rays per view meet, cheap sums over the space in sight, and what of it is wanted.

Compiled coarse views along rays through a dense window of voxel states.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera, invert_transform, points_inside, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE, OCCUPIED, UNKNOWN
from infomap_ros.views.information.view_query import camera_rays
from infomap_ros.views.sampling.surroundings import IntArray, Surroundings
from infomap_ros.views.situation import Situation, Teammate

_RAYS = (9, 7)  # of a coarse_view, across and down
_RAYS_IN_PLANE = 45
_STEP = 0.1  # [m] of the march along them
_FADE = 0.5  # [m] of unknown space behind which a glance expects little


@dataclass(frozen=True, eq=False)
class CoarseViews:
    """What a few rays per view meet; volumes as seen through the pyramids that rays stand for.

    Attributes:
        unknown: unknown volume in sight, shape (M,) [m^3].
        known: known volume in sight, shape (M,) [m^3].
        wanted: share of what the view informs of the region, by interests, shape (M,).
        left: share of what is wanted that teammates leave, shape (M,).
    """

    unknown: FloatArray
    known: FloatArray
    wanted: FloatArray
    left: FloatArray


def full_volume(situation: Situation) -> float:
    """Volume that the camera sees where nothing hides it [m^3]; in a plane that of one layer."""
    camera, reach = situation.camera, situation.max_range
    if situation.is_planar:
        size = situation.voxel_map.config.voxel_size
        return float(camera_rays(camera, 1.0, planar=True)[1].sum()) * reach**2 / 2.0 * size
    return camera.width * camera.height / (camera.fx * camera.fy) * reach**3 / 3.0


def coarse_view_at(
    situation: Situation,
    surroundings: Surroundings,
    information_weights: InformationWeights,
    poses: FloatArray,
) -> CoarseViews:
    """Send a few rays from each view.

    Args:
        situation: what is known.
        surroundings: its known space.
        information_weights: what of the information is wanted, by voxel.
        poses: ``T_map_camera``, shape (M, 4, 4).
    """
    size = surroundings.voxel_size
    rays, angle = _rays(situation)
    bounds = np.stack([situation.region.low, situation.region.high]) / size
    sums = np.zeros((len(poses), 5))
    coarse_view(
        surroundings.states,
        information_weights.kinds,
        information_weights.weights,
        bounds - surroundings.window.first,
        poses[:, :3, 3] / size - surroundings.window.first,
        np.ascontiguousarray(rays @ poses[:, :3, :3].transpose(0, 2, 1)),
        situation.max_range / size,
        max(1.0, _STEP / size),
        _FADE / size,
        1 if situation.is_planar else 2,
        sums,
    )
    volume = angle * size**3
    gained, wanted = np.maximum(sums[:, 2], 1e-12), np.maximum(sums[:, 3], 1e-12)
    return CoarseViews(
        sums[:, 0] * volume, sums[:, 1] * volume, sums[:, 3] / gained, sums[:, 4] / wanted
    )


def _rays(situation: Situation) -> tuple[FloatArray, float]:
    """Unit directions in the camera frame, (N, 3), and the angle that each stands for [sr]."""
    camera = situation.camera
    if situation.is_planar:
        rays, angles = camera_rays(camera, camera.field_of_view[0] / _RAYS_IN_PLANE, planar=True)
        return rays, float(angles.mean())
    u, v = np.meshgrid(*((np.arange(n) + 0.5) / n for n in _RAYS))
    pixels = u * camera.width - 0.5, v * camera.height - 0.5
    rays = np.stack(
        [
            (pixels[0] - camera.cx) / camera.fx,
            (pixels[1] - camera.cy) / camera.fy,
            np.ones(u.shape),
        ],
        axis=-1,
    ).reshape(-1, 3)
    lengths = np.linalg.norm(rays, axis=1, keepdims=True)
    solid_angle = 1.0 / (camera.fx * camera.fy) * camera.width * camera.height / len(rays)
    return rays / lengths, solid_angle * float(np.mean(lengths**-3))


_MOST_KINDS = 255


@dataclass(frozen=True, eq=False)
class InformationWeights:
    """Weights of the information of voxels.

    Attributes:
        kinds: row in `weights` of each voxel of the window, uint8; empty where all have row 0.
        weights: factor by interest, and share that teammates leave, shape (K, 2).
    """

    kinds: NDArray[np.uint8]
    weights: FloatArray

    def of(self, surroundings: Surroundings, points: FloatArray) -> FloatArray:
        """Both factors at points, (N, 3) [m, map] -> (N, 2); (1, 1) beyond the window."""
        places = surroundings.window.positions_of(points)
        inside = surroundings.window.contains(places)
        kinds = np.zeros(len(points), np.uint8)
        if self.kinds.size:
            kinds[inside] = self.kinds[tuple(places[inside].T)]
        return np.asarray(self.weights[kinds])


def information_weights_of(situation: Situation, surroundings: Surroundings) -> InformationWeights:
    """Weigh the voxels of the window by interests and by what teammates are about to see."""
    goals = [mate for mate in situation.teammates if mate.goal is not None]
    if not situation.interests and not goals:
        return InformationWeights(np.empty((0, 0, 0), np.uint8), np.ones((1, 2)))
    painter = _Painter(surroundings)
    for interest in situation.interests:
        middle = interest.place.transform[:3, 3]
        places = painter.around(middle, interest.place.solid.bounding_radius)
        inside = points_inside(surroundings.window.centers_of(places), [interest.place])
        painter.multiply(places[inside], 0, interest.weight)
    for mate in goals:
        painter.multiply(_about_to_see(surroundings, painter, mate, situation.camera), 1, 0.0)
    return InformationWeights(painter.kinds, np.array(painter.weights))


class _Painter:
    """Gives voxels with equal weights the same kind."""

    def __init__(self, surroundings: Surroundings) -> None:
        self.kinds = np.zeros(surroundings.states.shape, np.uint8)
        self.weights = [(1.0, 1.0)]
        self._surroundings = surroundings

    def around(self, middle: FloatArray, radius: float) -> IntArray:
        """Positions of the voxels in a cube around a place that have something to tell, (N, 3)."""
        states, window = self._surroundings.states, self._surroundings.window
        low, high = window.positions_of(middle + np.array([[-radius], [radius]]))
        low = np.clip(low, 0, states.shape)
        high = np.clip(high + 1, low, states.shape)
        part = states[tuple(map(slice, low, high))]
        return np.argwhere(part != FREE) + low

    def multiply(self, places: IntArray, column: int, factor: float) -> None:
        """Multiply one of the weights of the voxels at positions, (N, 3)."""
        where = tuple(places.T)
        old = self.kinds[where]
        for kind in np.unique(old):
            weights = list(self.weights[kind])
            weights[column] *= factor
            new = (weights[0], weights[1])
            if new not in self.weights and len(self.weights) < _MOST_KINDS:
                self.weights.append(new)
            if new in self.weights:
                chosen = tuple(axis[old == kind] for axis in where)
                self.kinds[chosen] = self.weights.index(new)


def _about_to_see(
    surroundings: Surroundings, painter: _Painter, mate: Teammate, own: PinholeCamera
) -> IntArray:
    """Positions of the voxels that a teammate's next view is going to see, (N, 3)."""
    assert mate.goal is not None
    camera, origin = mate.camera or own, mate.goal[:3, 3]
    places = painter.around(origin, mate.max_range)
    centers = surroundings.window.centers_of(places)
    in_camera = transform_points(invert_transform(mate.goal), centers)
    pixels = camera.project(in_camera)
    with np.errstate(invalid="ignore"):
        held = (pixels >= -0.5) & (pixels <= np.array([camera.width, camera.height]) - 0.5)
    near = np.linalg.norm(in_camera, axis=1) <= mate.max_range
    places = places[held.all(axis=1) & near]
    seen = np.empty(len(places), np.bool_)
    start = origin / surroundings.voxel_size - surroundings.window.first
    mark_in_sight(surroundings.states, start, places, seen)
    return np.asarray(places[seen])


@njit(cache=True, nogil=True)
def _is_clear(states: Any, origin: Any, target: Any, slack: float) -> bool:
    """Whether no occupied voxel lies between two places, up to `slack` before the second.

    Places in voxels, so that a voxel's position is the floor of what lies in it. Steps of half a
    voxel: a corner that is cut by less is not seen.
    """
    nx, ny, nz = states.shape
    dx, dy, dz = target[0] - origin[0], target[1] - origin[1], target[2] - origin[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    steps = int((length - slack) * 2.0)
    if steps <= 0:
        return True
    dx, dy, dz = 0.5 * dx / length, 0.5 * dy / length, 0.5 * dz / length
    x, y, z = origin[0], origin[1], origin[2]
    for _ in range(steps):
        x, y, z = x + dx, y + dy, z + dz
        a, b, c = math.floor(x), math.floor(y), math.floor(z)
        if a < 0 or b < 0 or c < 0 or a >= nx or b >= ny or c >= nz:
            return True
        if states[a, b, c] == OCCUPIED:
            return False
    return True


@njit(cache=True, nogil=True)
def gather_directions(
    states: Any,
    origins: Any,
    targets: Any,
    weights: Any,
    reach: float,
    limit: int,
    histogram: Any,
) -> None:
    """Sum the weights of the targets in sight of each origin, by direction.

    Args:
        states: shape (nx, ny, nz), as `VoxelWindow.states`.
        origins: shape (P, 3), in voxels of the window.
        targets: shape (T, 3), in voxels of the window.
        weights: shape (T,).
        reach: targets farther than this do not count, in voxels.
        limit: at most so many targets are looked for from one origin; of more, every n-th.
        histogram: shape (P, elevations, azimuths), zero; equal steps of the elevation from -pi/2
            to pi/2 and of the azimuth from -pi to pi.
    """
    rows, columns = histogram.shape[1], histogram.shape[2]
    stride = max(1, (len(targets) + limit - 1) // limit)
    for p in range(len(origins)):
        for t in range(p % stride, len(targets), stride):
            dx = targets[t, 0] - origins[p, 0]
            dy = targets[t, 1] - origins[p, 1]
            dz = targets[t, 2] - origins[p, 2]
            level = math.sqrt(dx * dx + dy * dy)
            if level * level + dz * dz > reach * reach:
                continue
            if not _is_clear(states, origins[p], targets[t], 2.0):
                continue
            elevation = math.atan2(dz, level) / math.pi + 0.5
            azimuth = math.atan2(dy, dx) / (2.0 * math.pi) + 0.5
            row = min(int(elevation * rows), rows - 1)
            column = min(int(azimuth * columns), columns - 1)
            histogram[p, row, column] += weights[t]


@njit(cache=True, nogil=True)
def mark_in_sight(states: Any, origin: Any, places: Any, seen: Any) -> None:
    """Which voxels, positions (N, 3), no occupied voxel hides from `origin`, (N,) bool.

    The origin is in voxels of the window, shape (3,).
    """
    target = np.empty(3)
    for i in range(len(places)):
        for axis in range(3):
            target[axis] = places[i, axis] + 0.5
        seen[i] = _is_clear(states, origin, target, 1.5)


@njit(cache=True, nogil=True)
def coarse_view(
    states: Any,
    kinds: Any,
    weights: Any,
    bounds: Any,
    origins: Any,
    directions: Any,
    reach: float,
    step: float,
    fade: float,
    power: int,
    sums: Any,
) -> None:
    """March a few rays of many views and sum up what lies on them.

    Every ray stands for a thin pyramid, so a step at distance r counts r^power, 2 in space and 1 in
    a plane. A ray ends at an
    occupied voxel; beyond the window all is unknown.

    Args:
        states: shape (nx, ny, nz), as `VoxelWindow.states`.
        kinds: row in `weights` of each voxel, uint8, that shape; or empty where all have row 0.
        weights: factors on the information of each kind: by interest, and by what teammates leave,
            shape (K, 2).
        bounds: box beyond which nothing counts, shape (2, 3), in voxels of the window.
        origins: of each view, shape (V, 3), in voxels of the window.
        directions: unit vectors, shape (V, R, 3).
        reach: length of the rays in voxels.
        step: of the march in voxels.
        fade: unknown space of this depth in voxels hides what is behind it, by 1/e.
        power: see above.
        sums: shape (V, 5), zero: within the bounds, the unknown and the known volume in sight,
            what they inform, what of that is wanted, and what of that teammates leave.
    """
    for view in range(len(origins)):
        for ray in range(directions.shape[1]):
            _march(
                states,
                kinds,
                weights,
                bounds,
                origins[view],
                directions[view, ray],
                reach,
                step,
                fade,
                power,
                sums[view],
            )


@njit(cache=True, nogil=True)
def _march(
    states: Any,
    kinds: Any,
    weights: Any,
    bounds: Any,
    origin: Any,
    direction: Any,
    reach: float,
    step: float,
    fade: float,
    power: int,
    sums: Any,
) -> None:
    nx, ny, nz = states.shape
    dx, dy, dz = direction[0], direction[1], direction[2]
    visible, dimming = 1.0, math.exp(-step / fade)
    for i in range(int(reach / step)):
        r = (i + 0.5) * step
        x, y, z = origin[0] + r * dx, origin[1] + r * dy, origin[2] + r * dz
        a, b, c = math.floor(x), math.floor(y), math.floor(z)
        inside = 0 <= a < nx and 0 <= b < ny and 0 <= c < nz
        state = states[a, b, c] if inside else np.uint8(UNKNOWN)
        within = bounds[0, 0] <= x < bounds[1, 0] and bounds[0, 1] <= y < bounds[1, 1]
        within = within and bounds[0, 2] <= z < bounds[1, 2]
        volume = r**power * step if within else 0.0
        sums[0 if state == UNKNOWN else 1] += volume
        if state == FREE:
            continue
        kind = kinds[a, b, c] if inside and kinds.size > 0 else np.uint8(0)
        gained = volume * visible
        wanted = gained * weights[kind, 0]
        sums[2] += gained
        sums[3] += wanted
        sums[4] += wanted * weights[kind, 1]
        if state == OCCUPIED:
            break
        visible *= dimming
