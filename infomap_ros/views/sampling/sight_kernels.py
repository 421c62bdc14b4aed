"""Compiled coarse views along rays through a dense window of voxel states."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping import FREE, OCCUPIED, UNKNOWN


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
            what they tell, what of that is wanted, and what of that teammates leave.
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
        told = volume * visible
        wanted = told * weights[kind, 0]
        sums[2] += told
        sums[3] += wanted
        sums[4] += wanted * weights[kind, 1]
        if state == OCCUPIED:
            break
        visible *= dimming
