"""The path that is driven, planned and shortened with OMPL from the lattice's path.

The lattice says whether and where a base can go, and how, in 16 headings from cell to cell. OMPL's
PathSimplifier shortens that path, and RRT-Connect (Kuffner and LaValle 2000,
https://doi.org/10.1109/ROBOT.2000.844730) looks for others where a shorter one can be. What they
insert lies up to a millimeter beside a straight line, as OMPL turns on curves of a small radius,
and a vehicle stops for each of these bends: places that cost more than passing them by are left
out. The best path is driven, the lattice's where none is better. Every motion is judged by the same
stances as the lattice's, in steps half as long. The effort is a number of samples: a clock would
make a path depend on what else the machine does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base.drive_graph import legs_of
from infomap_ros.motion.base.drive_space import DriveSpace, Links, state_of

REACH = 1.0
"""Longest motion by which OMPL's trees grow [m]."""
_SEED = 1
_TREES = 2  # searches by RRT-Connect, each within what the best path so far leaves
_SHORTCUTS = 150  # attempts of the simplifier; with twice as many paths cost 0.2 % less
_STOP = 0.15  # [m]; the rover brakes and starts again within 0.6 s, in which it drives this far
_SAME_TURNING = 1e-6  # [rad]
_LEAST_GAIN = 1e-6  # [m]
_SAME_PLACE = 1e-6  # [m]

# OMPL reports a seed that is set again as an error. Samplers take theirs when they are made, and
# each plan makes its own.
util.setLogLevel(util.LOG_NONE)


class DriveValidator(ob.MotionValidator):  # type: ignore[misc]
    """Answers OMPL whether the vehicle stands well everywhere on a motion.

    Args:
        information: OMPL's space information.
        space: where the vehicle can stand.
        links: its motions.
    """

    def __init__(self, information: Any, space: DriveSpace, links: Links) -> None:
        super().__init__(information)
        self._space, self._links = space, links

    def checkMotion(self, first: Any, last: Any) -> bool:
        """Whether the motion from one state to another is good."""
        motion = self._links.join(_place_of(first), _place_of(last))
        return self._space.fault_on(motion, steps=2) is None


class DriveObjective(ob.OptimizationObjective):  # type: ignore[misc]
    """Length with turns, as the lattice counts them.

    Args:
        information: OMPL's space information.
        links: the vehicle's motions.
    """

    def __init__(self, information: Any, links: Links) -> None:
        super().__init__(information)
        self._links = links

    def stateCost(self, state: Any) -> Any:
        """Places cost nothing."""
        return ob.Cost(0.0)

    def motionCost(self, first: Any, last: Any) -> Any:
        """Cost of the motion from one state to another [m]."""
        return ob.Cost(self._links.cost(_place_of(first), _place_of(last)))


class _Effort(NamedTuple):
    """What a path takes.

    Attributes:
        cost: as the lattice counts [m].
        turning: sum of all turns [rad].
        stops: to turn in place, or to change between forward and backward.
    """

    cost: float
    turning: float
    stops: int

    @property
    def price(self) -> float:
        """Cost and stops [m]."""
        return self.cost + _STOP * self.stops


class DrivenPath:
    """Plans paths of one vehicle on one terrain.

    Args:
        space: where the vehicle can stand.
        links: its motions.
    """

    def __init__(self, space: DriveSpace, links: Links) -> None:
        self._space, self._links = space, links

    def better_than(self, path: FloatArray, samples: int) -> FloatArray | None:
        """A path with the ends of another one that costs less, or None.

        It turns no more than the other one and costs less with stops and without, so that it takes
        no longer, whatever time a turn takes from what it costs upwards.

        Args:
            path: a path of the lattice, shape (K, 3).
            samples: random places that RRT-Connect may try.

        Returns:
            Shape (N, 3), every stance on it good.
        """
        if len(path) < 2 or self._space.fault_on(path) is not None:
            return None
        util.RNG.setSeed(_SEED)
        best, known = None, self._effort(path)
        cost, price = known.cost - _LEAST_GAIN, known.price - _LEAST_GAIN
        left = iter(range(samples))
        for attempt in range(_TREES + 1):
            search = _Search(self._space, self._links, (path[0], path[-1]), min(cost, price))
            found = search.shortened(path) if attempt == 0 else search.planned(left)
            if found is None:
                continue
            places = self._thinned(found)
            joined, effort = self._joined(places), self._effort(places)
            is_better = effort.cost < cost and effort.price < price
            turns_more = effort.turning > known.turning + _SAME_TURNING
            if is_better and not turns_more and self._space.fault_on(joined) is None:
                best, price = joined, effort.price
        return best

    def _thinned(self, places: FloatArray) -> FloatArray:
        """Without places that cost more than passing them by, shape (K, 3) -> (N, 3)."""
        if self._space.config.turning_radius > 0.0:
            return places
        kept, index = self._straightened(places), 1
        while index < len(kept) - 1:
            low, high = max(index - 2, 0), index + 4
            around = kept[low:high]
            fewer = self._straightened(np.delete(around, index - low, axis=0))
            is_less = self._effort(fewer).price < self._effort(around).price + _LEAST_GAIN
            if is_less and self._space.fault_on(fewer, steps=2) is None:
                kept = np.concatenate([kept[:low], fewer, kept[high:]])
                index = max(index - 1, 1)
            else:
                index += 1
        return kept

    def _straightened(self, places: FloatArray) -> FloatArray:
        """The same with the heading between two motions that the first arrives with."""
        straight, reverse = places.copy(), self._space.config.reverse
        for n in range(1, len(places) - 1):
            first, length, _ = legs_of(*straight[n - 1], *places[n], reverse)
            straight[n, 2] = straight[n - 1, 2] + first if length > 0.0 else straight[n - 1, 2]
        return straight

    def _effort(self, places: FloatArray) -> _Effort:
        """What driving through places takes."""
        path = self._space.in_steps(self._joined(places))
        cost = sum(self._links.cost(a, b) for a, b in pairwise(places))
        return _Effort(cost, float(np.abs(_turns_of(path)).sum()), stops_on(path))

    def _joined(self, places: FloatArray) -> FloatArray:
        """The path through places, as the vehicle drives from each to the next."""
        parts = [self._links.join(a, b)[1:] for a, b in pairwise(places)]
        return np.concatenate([places[:1], *parts])


class _Search:
    """OMPL's problem between two places, where a path that costs less than a bound can be.

    Args:
        space: where the vehicle can stand.
        links: its motions.
        ends: start and goal, shape (3,) each.
        bound: cost of a path that is known [m].
    """

    def __init__(
        self, space: DriveSpace, links: Links, ends: tuple[FloatArray, FloatArray], bound: float
    ) -> None:
        self._ends, self._reach = ends, REACH
        self._states = links.state_space()
        self._states.setBounds(_bounds(space, ends, bound))
        self._information = ob.SpaceInformation(self._states)
        checker = ob.AllValidStateValidityChecker(self._information)
        self._information.setStateValidityChecker(checker)
        self._information.setMotionValidator(DriveValidator(self._information, space, links))
        self._information.setup()
        self._objective = DriveObjective(self._information, links)

    def shortened(self, path: FloatArray) -> FloatArray:
        """A path made shorter: places on it are linked at random where that lowers the cost."""
        states = [state_of(self._states, place) for place in path]
        return self._simplified(og.PathGeometric(self._information, states))

    def planned(self, samples: Iterator[int]) -> FloatArray | None:
        """Some path by RRT-Connect, made shorter; None where the samples end before it is found.

        Args:
            samples: ends after as many random places as may be tried.
        """
        problem = ob.ProblemDefinition(self._information)
        start, goal = (state_of(self._states, place) for place in self._ends)
        problem.setStartAndGoalStates(start, goal)
        planner = og.RRTConnect(self._information)
        planner.setRange(self._reach)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(ob.PlannerTerminationCondition(lambda: next(samples, None) is None))
        if not problem.hasExactSolution():
            return None
        return self._simplified(problem.getSolutionPath())

    def _simplified(self, path: Any) -> FloatArray:
        simplifier = og.PathSimplifier(self._information, None, self._objective)
        simplifier.partialShortcutPath(path, _SHORTCUTS, _SHORTCUTS, 1.0)
        places = np.array([_place_of(state) for state in path.getStates()])
        places[0], places[-1] = self._ends
        return places


def _turns_of(path: FloatArray) -> FloatArray:
    """Turns between poses, shape (K, 3) -> (K - 1,) [rad]."""
    return (np.diff(path[:, 2]) + math.pi) % (2.0 * math.pi) - math.pi


def stops_on(path: FloatArray) -> int:
    """How often a vehicle turns in place or changes between forward and backward.

    It stops for each turn in place, however small.

    Args:
        path: in the steps in which it is driven, shape (K, 3).
    """
    steps, headings = np.diff(path[:, :2], axis=0), path[:-1, 2] + 0.5 * _turns_of(path)
    ahead = steps[:, 0] * np.cos(headings) + steps[:, 1] * np.sin(headings)
    kinds = np.where(np.hypot(*steps.T) < _SAME_PLACE, 0.0, np.copysign(1.0, ahead))
    changes = (kinds[1:] != kinds[:-1]) & (kinds[:-1] != 0.0)
    return int(changes.sum() + (kinds[:1] == 0.0).sum())


def _bounds(space: DriveSpace, ends: tuple[FloatArray, FloatArray], bound: float) -> Any:
    """A box about the ellipse of all places on a path no longer than a bound, within the grid."""
    a, b = ends[0][:2], ends[1][:2]
    between = math.dist(a, b)
    along = (b - a) / between if between > 0.0 else np.array([1.0, 0.0])
    halves = 0.5 * bound, 0.5 * math.sqrt(max(bound * bound - between * between, 0.0))
    half = np.hypot(halves[0] * along, halves[1] * along[::-1]) + space.grid[2]
    corner = space.grid[:2]
    low = np.maximum(0.5 * (a + b) - half, corner)
    end = corner + space.grid[2] * np.array(space.terrain.heights.shape)
    high = np.minimum(0.5 * (a + b) + half, end)
    bounds = ob.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, float(low[axis]))
        bounds.setHigh(axis, float(high[axis]))
    return bounds


def _place_of(state: Any) -> FloatArray:
    return np.array((state.getX(), state.getY(), state.getYaw()))
