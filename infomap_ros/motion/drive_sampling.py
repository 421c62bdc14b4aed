"""Sampling-based search for a way of the base with OMPL; no Python callback per state.

OMPL asks only whether a motion is good, and one compiled call answers for all states of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.drive_kernels import CLEAR, UNASKED, ask_drive, known_drive
from infomap_ros.motion.quick_stance import Ground

util.setLogLevel(util.LOG_ERROR)
util.RNG.setSeed(1)  # of all planners of this process, so that runs repeat


class DriveValidator(ob.MotionValidator):  # type: ignore[misc]
    """Answers OMPL from a lattice of cells (x, y, heading).

    Args:
        information: OMPL's space information.
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

    def checkMotion(self, first: Any, last: Any) -> bool:
        """Whether the way from one state to another is good."""
        a = (first.getX(), first.getY(), first.getYaw())
        b = (last.getX(), last.getY(), last.getYaw())
        state = known_drive(self._lattice, self._grid, a, b, self._reverse)
        if state == UNASKED:
            state = ask_drive(self._lattice, self._grid, a, b, self._reverse, self._ground)
        return bool(state == CLEAR)


def sample_way(
    lattice: NDArray[np.uint8],
    grid: FloatArray,
    start: FloatArray,
    goals: FloatArray,
    reverse: bool,
    reach: float,
    time_limit: float,
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
        time_limit: [s].
        ground: a `Ground`, for cells not asked yet.

    Returns:
        Places from the start to one of the goals, shape (K, 3), or None.
    """
    space = ob.SE2StateSpace()
    bounds = ob.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, float(grid[axis]))
        bounds.setHigh(axis, float(grid[axis] + lattice.shape[axis] * grid[2]))
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)
    information.setStateValidityChecker(ob.AllValidStateValidityChecker(information))
    validator = DriveValidator(information, lattice, grid, reverse, ground)
    information.setMotionValidator(validator)
    information.setup()
    problem = ob.ProblemDefinition(information)
    problem.addStartState(_state(space, start))
    targets = ob.GoalStates(information)
    for goal in goals:
        targets.addState(_state(space, goal))
    problem.setGoal(targets)
    planner = og.RRTConnect(information)
    planner.setRange(reach)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(ob.timedPlannerTerminationCondition(time_limit))
    if not problem.hasExactSolution():
        return None
    states = problem.getSolutionPath().getStates()
    return np.array([(state.getX(), state.getY(), state.getYaw()) for state in states])


def _state(space: Any, place: FloatArray) -> Any:
    state = space.allocState()
    state.setXY(float(place[0]), float(place[1]))
    state.setYaw(float((place[2] + np.pi) % (2.0 * np.pi) - np.pi))
    return state
