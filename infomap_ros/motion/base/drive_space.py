"""Where a vehicle can stand and drive on a terrain, found out as it is asked."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base import drive_kernels, drive_points
from infomap_ros.motion.base.base_path import BasePath, BasePlannerConfig
from infomap_ros.motion.base.drive_graph import (
    HEADINGS,
    IN_PLACE,
    DriveGraph,
    arc_moves,
    empty_graph,
)
from infomap_ros.motion.base.stance import Ground, TerrainArrays, VehicleArrays
from infomap_ros.motion.base.vehicle import Vehicle, terrain_arrays

TURN_STEP = 2.0 * np.pi / 32.0
"""No turn goes farther without a stance being asked [rad]: half the step of the lattice."""


class DriveSpace:
    """Memory of one terrain and one vehicle.

    Args:
        terrain: the ground.
        vehicle: the robot.
        config: of the planner.
        known: what was found out before; where the ground is the same it still holds.
    """

    def __init__(
        self,
        terrain: Terrain,
        vehicle: Vehicle,
        config: BasePlannerConfig,
        known: DriveSpace | None = None,
    ) -> None:
        self.terrain, self.vehicle, self.config = terrain, vehicle, config
        self.grid = np.array([*terrain.origin, terrain.resolution, TURN_STEP])
        arrays = terrain_arrays(terrain, vehicle.config)
        self.ground = Ground.of(arrays, vehicle.arrays)
        in_place = config.turning_radius == 0.0
        self.arcs = IN_PLACE if in_place else arc_moves(config.turning_radius / self.grid[2])
        self.graph = empty_graph(terrain.heights.shape, in_place)
        if known is not None:
            carry_over(known.graph, self.graph, known.ground, self.ground)

    def without_margin(self) -> DriveSpace:
        """The same ground for the vehicle as it is, kept from nothing by a margin."""
        return DriveSpace(self.terrain, self.vehicle.without_margin(), self.config)

    def stands(self, place: FloatArray) -> bool:
        """Whether the robot may stand at x, y, yaw."""
        return self.fault_on(place[None]) is None

    def fault_on(self, places: FloatArray, steps: int = 1) -> FloatArray | None:
        """Place of the first stance on a way that is not good, shape (3,); None if all are.

        Args:
            places: the way, shape (K, 3).
            steps: stances to a cell's length, and to a step of the headings.
        """
        fault, spacing, angle = np.empty(3), self.grid[2] / steps, self.grid[3] / steps
        good = drive_kernels.drives_well(
            places, self.config.reverse, spacing, angle, self.ground, fault
        )
        return None if good else fault

    def standable_goals(self, goals: FloatArray) -> tuple[FloatArray, NDArray[np.int64], list[str]]:
        """Goals at which the robot may stand, NaN headings replaced by each heading that is good.

        Returns:
            Places, shape (P, 3); the goal that each stands for, shape (P,); and per goal why it
            has none, empty where it has.
        """
        rows, owners = [], []
        for index, (x, y, yaw) in enumerate(goals):
            headings = HEADINGS if np.isnan(yaw) else np.array([yaw])
            rows.append(np.column_stack([np.full((len(headings), 2), (x, y)), headings]))
            owners += [index] * len(headings)
        places, owner = np.concatenate(rows), np.array(owners)
        good = self.vehicle.stances(self.terrain, places).ok
        reasons = []
        for index in range(len(goals)):
            own = np.flatnonzero(owner == index)
            bad = "" if good[own].any() else self._reason_at(places[own[0]])
            reasons.append(bad and f"goal: {bad}")
        return places[good], owner[good], reasons

    def _reason_at(self, place: FloatArray) -> str:
        return self.vehicle.stance(self.terrain, *(float(value) for value in place)).reason

    def in_steps(self, way: FloatArray) -> FloatArray:
        """A way in the steps in which it is asked and driven, shape (K, 3) -> (N, 3)."""
        config, poses = self.config, np.array(way)
        if config.turning_radius == 0.0:
            poses = drive_points.points_along(poses, config.reverse, self.grid[2], self.grid[3])
        return poses

    def finished(self, way: FloatArray, goal: int, method: str, reason: str = "") -> BasePath:
        """A way as the caller gets it: in the steps in which it was asked, each with its stance."""
        poses = self.in_steps(way)
        poses[:, 2] = np.unwrap(poses[:, 2])
        length = float(np.hypot(*np.diff(way[:, :2], axis=0).T).sum())
        stances = standing_on(poses, self.vehicle.stances(self.terrain, poses).T_map_base)
        return BasePath(poses, stances, length, not reason, reason, goal, method)

    def nowhere(self, reason: str) -> BasePath:
        """No way at all."""
        return BasePath(np.zeros((0, 3)), np.zeros((0, 4, 4)), 0.0, False, reason, -1, "nothing")


def standing_on(poses: FloatArray, stances: FloatArray) -> FloatArray:
    """Stances with those that are not known taken from their nearest neighbors on the way.

    A robot that leaves a place where it should not stand may come by ground that the map does not
    know. Where no stance is known the ground counts as level, at height zero.

    Args:
        poses: x, y [m] and yaw [rad], shape (K, 3).
        stances: ``T_map_base`` of each, shape (K, 4, 4); NaN where there is none.
    """
    known = np.flatnonzero(np.isfinite(stances).all(axis=(1, 2)))
    planar = _planar(poses)
    if len(known) == len(poses) or not len(known):
        return stances if len(known) else planar
    nearest = known[np.abs(np.arange(len(poses))[:, None] - known).argmin(axis=1)]
    moved = planar @ np.linalg.inv(planar[nearest]) @ stances[nearest]
    moved[known] = stances[known]
    return moved


def _planar(poses: FloatArray) -> FloatArray:
    """Level transforms at height zero, shape (K, 3) -> (K, 4, 4)."""
    transforms = np.tile(np.eye(4), (len(poses), 1, 1))
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    transforms[:, 0, 0], transforms[:, 0, 1] = cos, -sin
    transforms[:, 1, 0], transforms[:, 1, 1] = sin, cos
    transforms[:, :2, 3] = poses[:, :2]
    return transforms


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
