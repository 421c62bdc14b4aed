"""The grid of where the rover can stand, against its stances and the rules of planners."""

from __future__ import annotations

import numpy as np

from infomap_ros.motion.reaching import traversability

from .grounds import CELL, ground, rover, stance_of


def made_up(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Level, a ledge of 0.3 m at x = 1, a slope of 50 degrees from y = 1 on, unknown at x < -1."""
    heights = np.where(x > 1.0, 0.3, 0.0) + np.where(y > 1.0, 1.2 * (y - 1.0), 0.0)
    return np.where(x < -1.0, np.nan, heights)


def test_free_where_it_stands_in_all_headings_and_occupied_where_in_none() -> None:
    vehicle, terrain = rover(), ground(made_up)
    grid = traversability(terrain, vehicle)
    assert grid.cells.shape == terrain.heights.T.shape
    assert (grid.origin, grid.resolution) == (terrain.origin, CELL)

    def value(x: float, y: float) -> int:
        column, row = np.floor((np.array([x, y]) - grid.origin) / grid.resolution).astype(int)
        return int(grid.cells[row, column])

    assert value(0.0, 0.0) == 0
    assert value(1.5, 0.0) == 0  # upon the ledge
    assert value(1.0, 0.0) == 100
    assert value(0.0, 1.35) == 100
    assert value(-1.5, 0.0) == -1
    assert value(-1.03, 0.0) == -1  # half over unknown ground
    for row, column in np.random.default_rng(1).integers(0, len(grid.cells), (40, 2)):
        place = (np.array([column, row]) + 0.5) * CELL + grid.origin
        yaws = np.arange(8) * np.pi / 4.0
        reasons = [stance_of(vehicle, terrain, *place, yaw).reason for yaw in yaws]
        known = [why for why in reasons if "unknown" not in why and "outside" not in why]
        share = sum(map(bool, known)) / max(len(known), 1)
        assert grid.cells[row, column] == (round(100 * share) if known else -1)
