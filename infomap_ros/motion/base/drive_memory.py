"""What was found out about ground that has not changed since."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from infomap_ros.motion.base.drive_graph import DriveGraph
from infomap_ros.motion.base.quick_stance import Ground
from infomap_ros.motion.base.stance import TerrainArrays, VehicleArrays

_BESIDE = 3  # cells beyond the body that a stance in a cell, or half-way to the next, depends on
_GRIDS = TerrainArrays._fields[:-3]


def carry_over(old: DriveGraph, new: DriveGraph, before: Ground, now: Ground) -> None:
    """Copy the answers for cells around which the ground is the same, for the same vehicle.

    Args:
        old: a graph of the ground before.
        new: a graph of the ground now; its nodes, turns and moves are filled.
        before: the ground of `old`.
        now: the ground of `new`.
    """
    shift = _shift_between(before.terrain, now.terrain)
    if shift is None or not _same_vehicle(before.vehicle, now.vehicle):
        return
    there, here = _overlap(old.nodes.shape[:2], new.nodes.shape[:2], shift)
    changed = np.ones(new.nodes.shape[:2], np.bool_)
    changed[here] = _differ(before.terrain, now.terrain, there, here)
    reach = math.ceil(now.vehicle.reach / now.terrain.resolution) + _BESIDE
    changed = maximum_filter(changed, 2 * reach + 1, mode="constant", cval=True)
    keep = ~changed[here]
    # Arcs reach beyond the cells from which they begin; they are asked again.
    in_place = new.rights.size == 1 == old.rights.size
    tables = ("nodes", "turns", "moves") if in_place else ("nodes", "moves")
    for name in tables:
        getattr(new, name)[here][keep] = getattr(old, name)[there][keep]


def _shift_between(before: TerrainArrays, now: TerrainArrays) -> tuple[int, int] | None:
    """Cell of `now` in which cell (0, 0) of `before` lies; None where their cells differ."""
    if before.resolution != now.resolution:
        return None
    cells = np.array([before.x - now.x, before.y - now.y]) / now.resolution
    whole = np.round(cells)
    if np.abs(cells - whole).max() > 1e-6:
        return None
    return int(whole[0]), int(whole[1])


def _same_vehicle(one: VehicleArrays, other: VehicleArrays) -> bool:
    return all(np.array_equal(getattr(one, n), getattr(other, n)) for n in one._fields)


Part = tuple[slice, slice]


def _overlap(
    old: tuple[int, ...], new: tuple[int, ...], shift: tuple[int, int]
) -> tuple[Part, Part]:
    """The cells that both grids have, as parts of the old and of the new one."""
    low = [max(0, offset) for offset in shift]
    high = [max(low[k], min(new[k], old[k] + shift[k])) for k in range(2)]
    there = (
        slice(low[0] - shift[0], high[0] - shift[0]),
        slice(low[1] - shift[1], high[1] - shift[1]),
    )
    return there, (slice(low[0], high[0]), slice(low[1], high[1]))


def _differ(
    before: TerrainArrays, now: TerrainArrays, there: Part, here: Part
) -> NDArray[np.bool_]:
    """Cells of the overlap in which any grid differs."""
    differ = np.zeros(getattr(now, _GRIDS[0])[here].shape, np.bool_)
    for name in _GRIDS:
        a, b = getattr(before, name)[there], getattr(now, name)[here]
        differ |= (a != b) & ~(np.isnan(a) & np.isnan(b))
    return differ
