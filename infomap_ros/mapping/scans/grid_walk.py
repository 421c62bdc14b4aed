"""From voxel to voxel along a line (Amanatides and Woo 1987)."""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import inlined_kernel, kernel


@kernel
def begin_walk(x: float, y: float, z: float, dx: float, dy: float, dz: float) -> Any:
    """The voxel of a point, and what `next_voxel` needs to go on from there.

    Args:
        x: first coordinate of the point [voxels], likewise y and z.
        y: see x.
        z: see x.
        dx: first coordinate of the direction, whose length is the unit of the way; likewise dy, dz.
        dy: see dx.
        dz: see dx.

    Returns:
        Index of the voxel; the way to its first crossing along each axis; the steps of the index;
        and the way between two crossings. Each a tuple of three.
    """
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    step_x, next_x, delta_x = _axis_start(x, dx, i)
    step_y, next_y, delta_y = _axis_start(y, dy, j)
    step_z, next_z, delta_z = _axis_start(z, dz, k)
    return (
        (i, j, k),
        (next_x, next_y, next_z),
        (step_x, step_y, step_z),
        (delta_x, delta_y, delta_z),
    )


@kernel
def _axis_start(position: float, direction: float, cell: int) -> tuple[int, float, float]:
    """Step, way to the first crossing and between two of them along one axis."""
    if direction > 0.0:
        return 1, (cell + 1 - position) / direction, 1.0 / direction
    if direction < 0.0:
        return -1, (cell - position) / direction, -1.0 / direction
    return 0, np.inf, np.inf


@kernel
def way_through(crossings: Any) -> float:
    """The way to where the line leaves the voxel."""
    return min(crossings[0], min(crossings[1], crossings[2]))


@kernel
def next_voxel(voxel: Any, crossings: Any, steps: Any, deltas: Any) -> Any:
    """The next voxel and its crossings; see `begin_walk`."""
    i, j, k = voxel
    x, y, z = crossings
    leave = way_through(crossings)
    if x == leave:
        return (i + steps[0], j, k), (x + deltas[0], y, z)
    if y == leave:
        return (i, j + steps[1], k), (x, y + deltas[1], z)
    return (i, j, k + steps[2]), (x, y, z + deltas[2])


@inlined_kernel
def next_of_short_walk(voxel: Any, crossings: Any, steps: Any, deltas: Any) -> Any:
    """As `next_voxel`, without a branch.

    The processor cannot foresee how walks of a few voxels turn; how a long one turns, it can, and
    there this takes a third longer.
    """
    i, j, k = voxel
    x, y, z = crossings
    leave = way_through(crossings)
    is_x = x == leave
    is_y = (not is_x) & (y == leave)
    is_z = not (is_x | is_y)
    voxel = (
        i + (steps[0] if is_x else 0),
        j + (steps[1] if is_y else 0),
        k + (steps[2] if is_z else 0),
    )
    crossings = (
        x + (deltas[0] if is_x else 0.0),
        y + (deltas[1] if is_y else 0.0),
        z + (deltas[2] if is_z else 0.0),
    )
    return voxel, crossings
