"""Sampling-based search for a way of the base with OMPL; no Python callback per state.

OMPL asks only whether a motion is good, and one compiled call answers for all states of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import typeof
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base.drive_kernels import CLEAR, UNASKED, ask_drive, known_drive_in_cells
from infomap_ros.motion.base.quick_stance import Ground

_TURN_WEIGHT = 0.5  # of a turn in the distance of two states [m/rad], as OMPL has it

util.setLogLevel(util.LOG_ERROR)
util.RNG.setSeed(1)  # of all planners of this process, so that runs repeat


class DriveValidator(ob.MotionValidator):  # type: ignore[misc]
    """Answers OMPL from a lattice of cells (x, y, heading).

    Args:
        information: OMPL's space information, its states in cells from the grid's corner.
        lattice: of cells, as in `drive_kernels`.
        grid: corner and edge of its cells, shape (3,) [m, map].
        reverse: whether driving backwards is allowed.
        ground: a `Ground`, for cells not asked yet.
    """

    def __init__(
        self,
        information: Any,
        lattice: NDArray[np.uint8],
        grid: FloatArray,
        reverse: bool,
        ground: Ground,
    ) -> None:
        super().__init__(information)
        self._lattice, self._grid, self._reverse = lattice, grid, reverse
        self._ground = ground
        self._known = _entry_point(known_drive_in_cells, lattice, *(0.0,) * 6, reverse)

    def checkMotion(self, first: Any, last: Any) -> bool:
        """Whether the way from one state to another is good."""
        state = self._known(
            self._lattice,
            first.getX(), first.getY(), first.getYaw(), last.getX(), last.getY(), last.getYaw(),
            self._reverse,
        )  # fmt: skip
        return bool((self._ask(first, last) if state == UNASKED else state) == CLEAR)

    def _ask(self, first: Any, last: Any) -> int:
        """State of a motion, cells on it asked that were not asked yet."""
        ends = (np.array((s.getX(), s.getY(), s.getYaw())) for s in (first, last))
        a, b = (_in_metres(end, self._grid) for end in ends)
        return int(ask_drive(self._lattice, self._grid, a, b, self._reverse, self._ground))


def _entry_point(kernel: Any, *arguments: Any) -> Any:
    """A kernel compiled for these arguments, without the choice among its variants at each call.

    That choice takes as long as the answer itself. Uncompiled the kernel is its own entry point.
    """
    kernel(*arguments)
    if not hasattr(kernel, "overloads"):
        return kernel
    return kernel.overloads[tuple(typeof(argument) for argument in arguments)].entry_point


def sample_way(
    lattice: NDArray[np.uint8],
    grid: FloatArray,
    start: FloatArray,
    goals: FloatArray,
    reverse: bool,
    reach: float,
    samples: Iterator[int],
    ground: Ground,
) -> FloatArray | None:
    """Find some way with RRT-Connect (Kuffner and LaValle 2000).

    https://doi.org/10.1109/ROBOT.2000.844730

    Args:
        lattice: of cells, as in `drive_kernels`.
        grid: corner and edge of its cells, shape (3,) [m, map].
        start: x, y, yaw, shape (3,).
        goals: any of them will do, shape (G, 3).
        reverse: whether driving backwards is allowed.
        reach: longest motion by which a tree grows [m].
        samples: ends after as many random places as may be tried; what is left of it is for
            another call. A clock would make a run depend on what else the machine does.
        ground: a `Ground`, for cells not asked yet.

    Returns:
        Places from the start to one of the goals, shape (K, 3), or None.
    """
    space = ob.SE2StateSpace()
    space.setSubspaceWeight(1, _TURN_WEIGHT / float(grid[2]))
    bounds = ob.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, 0.0)
        bounds.setHigh(axis, float(lattice.shape[axis]))
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)
    information.setStateValidityChecker(ob.AllValidStateValidityChecker(information))
    validator = DriveValidator(information, lattice, grid, reverse, ground)
    information.setMotionValidator(validator)
    information.setup()
    problem = ob.ProblemDefinition(information)
    problem.addStartState(_state(space, start, grid))
    targets = ob.GoalStates(information)
    for goal in goals:
        targets.addState(_state(space, goal, grid))
    problem.setGoal(targets)
    planner = og.RRTConnect(information)
    planner.setRange(reach / float(grid[2]))
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(ob.PlannerTerminationCondition(lambda: next(samples, None) is None))
    if not problem.hasExactSolution():
        return None
    states = problem.getSolutionPath().getStates()
    way = np.array([(state.getX(), state.getY(), state.getYaw()) for state in states])
    return _in_metres(way, grid)


def _in_metres(places: FloatArray, grid: FloatArray) -> FloatArray:
    """Places in cells from the grid's corner, shape (..., 3), in the map."""
    scale = np.array([grid[2], grid[2], 1.0])
    return np.asarray(places * scale + (grid[0], grid[1], 0.0))


def _state(space: Any, place: FloatArray, grid: FloatArray) -> Any:
    """OMPL's state of a place: in cells, as then no motion needs the grid."""
    state = space.allocState()
    x, y = (place[:2] - grid[:2]) / grid[2]
    state.setXY(float(x), float(y))
    state.setYaw(float((place[2] + np.pi) % (2.0 * np.pi) - np.pi))
    return state
