"""Compiled descent to joint positions that place a camera; see `inverse_kinematics`.

The camera's error is a vector of m numbers: its position [m] above its rotation vector [rad], both
in the base frame (m = 6), or above the two turns about its own x and y axes that bring its viewing
direction to the target's (m = 5, the roll about the optical axis is free).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.motion.robot.chain import fill_jacobian, place_chain

DAMPING = 0.05  # per squared error; 0.02 to 0.1 are within a few percent of each other in time
LEAST_DAMPING = 1e-6  # keeps the matrix regular at the goal
LARGEST_STEP = 1.0  # of a joint in one iteration [rad or m]
PROGRESS = 0.9  # a squared error below this times the best so far counts as progress
PATIENCE = 2  # iterations without progress that end a descent
ITERATIONS = 40  # at most, from one start
REFINED = 1e-6  # squared error, in units of the tolerances, below which refining ends

_TURN = 2.0 * math.pi
_OPPOSITE = 1e-12  # sine below which a rotation by pi has no axis


class Scratch(NamedTuple):
    """Memory of one descent, for a chain of n joints with S rows."""

    places: NDArray[np.float64]  # (S + 1, 3, 4)
    jacobian: NDArray[np.float64]  # (6, n)
    rows: NDArray[np.float64]  # (6, n), weighted
    error: NDArray[np.float64]  # (6,), weighted
    normal: NDArray[np.float64]  # (6, 6)
    pulls: NDArray[np.float64]  # (6,)
    free: NDArray[np.bool_]  # (n,)
    q: NDArray[np.float64]  # (n,)


class Goal(NamedTuple):
    """What a descent is to reach.

    Attributes:
        direction_only: the roll about the optical axis is free.
        position_tolerance: [m].
        rotation_tolerance: [rad].
    """

    direction_only: bool
    position_tolerance: float
    rotation_tolerance: float


class Arm(NamedTuple):
    """What a search has to know of a chain besides its `ChainArrays`.

    Attributes:
        lower: limits [rad or m], shape (n,).
        upper: limits [rad or m], shape (n,).
        prismatic: slides, shape (n,).
        low: from where random starts are drawn, finite, shape (n,).
        high: up to where, shape (n,).
        root: origin of the first joint [m], shape (3,).
        reach: no camera is farther from it [m].
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    prismatic: NDArray[np.bool_]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    root: NDArray[np.float64]
    reach: float


@njit(cache=True, nogil=True)
def make_scratch(steps: int, joints: int) -> Any:
    """Memory for a chain of `joints` joints with `steps` rows."""
    return Scratch(
        np.empty((steps + 1, 3, 4)),
        np.empty((6, joints)),
        np.empty((6, joints)),
        np.empty(6),
        np.empty((6, 6)),
        np.empty(6),
        np.empty(joints, np.bool_),
        np.empty(joints),
    )


@njit(cache=True, nogil=True)
def rotation_error(camera: Any, target: Any, error: Any) -> float:
    """Write the rotation vector from camera to target into ``error[3:6]``; return its angle."""
    x = y = z = trace = 0.0
    for k in range(3):
        x += camera[1, k] * target[2, k] - camera[2, k] * target[1, k]
        y += camera[2, k] * target[0, k] - camera[0, k] * target[2, k]
        z += camera[0, k] * target[1, k] - camera[1, k] * target[0, k]
        trace += camera[0, k] * target[0, k] + camera[1, k] * target[1, k]
        trace += camera[2, k] * target[2, k]
    twice_sine = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(twice_sine, trace - 1.0)
    if twice_sine > _OPPOSITE:
        factor = angle / twice_sine
        error[3], error[4], error[5] = factor * x, factor * y, factor * z
    else:  # no turn, or half a turn: any axis leaves it
        error[3], error[4], error[5] = angle, 0.0, 0.0
    return angle


@njit(cache=True, nogil=True)
def direction_error(camera: Any, target: Any, error: Any) -> float:
    """Write the turns about the camera's x and y into ``error[3:5]``; return their angle."""
    x = y = z = 0.0
    for i in range(3):
        x += camera[i, 0] * target[i, 2]
        y += camera[i, 1] * target[i, 2]
        z += camera[i, 2] * target[i, 2]
    sine = math.sqrt(x * x + y * y)
    angle = math.atan2(sine, z)
    if sine > _OPPOSITE:
        error[3], error[4] = -angle / sine * y, angle / sine * x
    else:
        error[3], error[4] = angle, 0.0
    error[5] = 0.0
    return angle


@njit(cache=True, nogil=True)
def camera_error(camera: Any, target: Any, direction_only: bool, error: Any) -> tuple[float, float]:
    """Write the error, shape (6,), and return the distance [m] and angle [rad]."""
    square = 0.0
    for i in range(3):
        error[i] = target[i, 3] - camera[i, 3]
        square += error[i] * error[i]
    if direction_only:
        return math.sqrt(square), direction_error(camera, target, error)
    return math.sqrt(square), rotation_error(camera, target, error)


@njit(cache=True, nogil=True)
def weigh(camera: Any, jacobian: Any, direction_only: bool, weight: float, rows: Any) -> None:
    """Rows of the weighted error's derivative by the joints, shape (m, n), from the Jacobian."""
    for j in range(jacobian.shape[1]):
        for i in range(3):
            rows[i, j] = weight * jacobian[i, j]
        a, b, c = jacobian[3, j], jacobian[4, j], jacobian[5, j]
        if direction_only:
            rows[3, j] = camera[0, 0] * a + camera[1, 0] * b + camera[2, 0] * c
            rows[4, j] = camera[0, 1] * a + camera[1, 1] * b + camera[2, 1] * c
        else:
            rows[3, j], rows[4, j], rows[5, j] = a, b, c


@njit(cache=True, nogil=True)
def find_free(rows: Any, error: Any, m: int, q: Any, lower: Any, upper: Any, free: Any) -> None:
    """Mark the joints that do not stand at a limit against which the error pulls them."""
    for j in range(q.shape[0]):
        pull = 0.0
        for i in range(m):
            pull += rows[i, j] * error[i]
        free[j] = not ((q[j] <= lower[j] and pull < 0.0) or (q[j] >= upper[j] and pull > 0.0))


@njit(cache=True, nogil=True)
def solve_damped(
    rows: Any, error: Any, m: int, free: Any, damping: float, normal: Any, pulls: Any
) -> None:
    """Solve ``(A A^T + damping I) pulls = error``, A the free columns of `rows`, by Cholesky."""
    for i in range(m):
        for k in range(i + 1):
            total = damping if i == k else 0.0
            for j in range(free.shape[0]):
                if free[j]:
                    total += rows[i, j] * rows[k, j]
            for j in range(k):
                total -= normal[i, j] * normal[k, j]
            normal[i, k] = math.sqrt(total) if i == k else total / normal[k, k]
        total = error[i]
        for k in range(i):
            total -= normal[i, k] * pulls[k]
        pulls[i] = total / normal[i, i]
    for i in range(m - 1, -1, -1):
        total = pulls[i]
        for k in range(i + 1, m):
            total -= normal[k, i] * pulls[k]
        pulls[i] = total / normal[i, i]


@njit(cache=True, nogil=True)
def within(position: float, lower: float, upper: float, prismatic: bool) -> float:
    """A position beyond a limit: the same one a turn away if that is allowed, else the limit."""
    if position > upper:
        return position - _TURN if not prismatic and position - _TURN >= lower else upper
    if position < lower:
        return position + _TURN if not prismatic and position + _TURN <= upper else lower
    return position


@njit(cache=True, nogil=True)
def take_step(
    rows: Any, pulls: Any, m: int, free: Any, lower: Any, upper: Any, prismatic: Any, q: Any
) -> None:
    """Move the free joints by ``A^T pulls``, no further than LARGEST_STEP, within the limits."""
    largest = LARGEST_STEP
    for shrink in range(2):
        for j in range(q.shape[0]):
            if not free[j]:
                continue
            step = 0.0
            for i in range(m):
                step += rows[i, j] * pulls[i]
            if shrink == 0:
                largest = max(largest, abs(step))
            else:
                moved = q[j] + step * LARGEST_STEP / largest
                q[j] = within(moved, lower[j], upper[j], prismatic[j])


@njit(cache=True, nogil=True)
def descend(
    chain: Any, arm: Any, target: Any, goal: Any, best: Any, memory: Any
) -> tuple[bool, float, float]:
    """Go from positions to better ones by damped least squares, within the limits.

    The damping is that of Levenberg and Marquardt, proportional to the squared error, which needs
    neither a line search nor a solvable target (Sugihara 2011, doi:10.1109/TRO.2011.2148230).
    A joint at a limit against which the error pulls it is left out of the step.

    Args:
        chain: a `ChainArrays`.
        arm: an `Arm`.
        target: ``T_base_camera``, upper three rows.
        goal: a `Goal`.
        best: start, then the best positions on the way, shape (n,).
        memory: a `Scratch`.

    Returns:
        Whether the goal is reached, distance [m] and angle [rad] at `best`.
    """
    lower, upper, prismatic = arm.lower, arm.upper, arm.prismatic
    places, jacobian, rows, error, normal, pulls, free, q = memory
    direction_only, position_tolerance, rotation_tolerance = goal
    weight, m = rotation_tolerance / position_tolerance, 5 if direction_only else 6
    refined = REFINED * rotation_tolerance * rotation_tolerance
    best_square, best_distance, best_angle, idle, reached = np.inf, np.inf, np.inf, 0, False
    q[:] = best
    for _ in range(ITERATIONS):
        place_chain(chain, q, places)
        distance, angle = camera_error(places[-1], target, direction_only, error)
        square = (weight * distance) ** 2 + angle * angle
        inside = distance <= position_tolerance and angle <= rotation_tolerance
        if reached and not (inside and square < 0.5 * best_square):
            break
        idle = 0 if square < PROGRESS * best_square else idle + 1
        if inside or square < best_square:
            best_square, best_distance, best_angle, reached = square, distance, angle, inside
            best[:] = q
        if idle > PATIENCE or square < refined:
            break
        for i in range(3):
            error[i] *= weight
        fill_jacobian(chain, places, jacobian)
        weigh(places[-1], jacobian, direction_only, weight, rows)
        find_free(rows, error, m, q, lower, upper, free)
        solve_damped(rows, error, m, free, DAMPING * square + LEAST_DAMPING, normal, pulls)
        take_step(rows, pulls, m, free, lower, upper, prismatic, q)
    return reached, best_distance, best_angle


@njit(cache=True, nogil=True)
def random_unit(seed: int, stream: int, index: int) -> float:
    """A number in [0, 1) that depends on nothing but its arguments, so that threads do not matter.

    SplitMix64 (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195).
    """
    x = np.uint64(seed) * np.uint64(0xD1342543DE82EF95) + np.uint64(stream)
    x = x * np.uint64(0xDA942042E4DD58B5) + np.uint64(index + 1) * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x = x ^ (x >> np.uint64(31))
    return float(x >> np.uint64(11)) / 9007199254740992.0


@njit(cache=True, nogil=True)
def start_at(arm: Any, start: Any, seed: int, stream: int, attempt: int, q: Any) -> None:
    """The first attempt starts at `start`, all others at random."""
    n = q.shape[0]
    for j in range(n):
        if attempt == 0:
            q[j] = start[j]
        else:
            unit = random_unit(seed, stream, attempt * n + j)
            q[j] = arm.low[j] + unit * (arm.high[j] - arm.low[j])


@njit(cache=True, nogil=True)
def unwind(arm: Any, start: Any, q: Any) -> None:
    """Of the positions that are whole turns apart take the allowed one nearest to `start`."""
    for j in range(q.shape[0]):
        if arm.prismatic[j]:
            continue
        near = q[j] + _TURN * np.round((start[j] - q[j]) / _TURN)
        while near > arm.upper[j]:
            near -= _TURN
        while near < arm.lower[j]:
            near += _TURN
        if near <= arm.upper[j]:
            q[j] = near


@njit(cache=True, nogil=True)
def attempts_for(arm: Any, target: Any, goal: Any, most: int) -> int:
    """One where no stretched arm's camera comes from the first joint to the target, else all."""
    square = 0.0
    for i in range(3):
        square += (target[i, 3] - arm.root[i]) ** 2
    return 1 if math.sqrt(square) > arm.reach + goal.position_tolerance else most


@njit(cache=True, nogil=True)
def next_solution(
    chain: Any,
    arm: Any,
    target: Any,
    goal: Any,
    start: Any,
    seed: int,
    stream: int,
    attempts: tuple[int, int],
    q: Any,
    memory: Any,
) -> tuple[int, bool, float, float]:
    """Descend from one start after the other until one reaches the goal.

    Args:
        chain: a `ChainArrays`.
        arm: an `Arm`.
        target: ``T_base_camera``, shape (4, 4).
        goal: a `Goal`.
        start: of the first attempt, shape (n,).
        seed: of the random starts.
        stream: number of the target; each has its own starts.
        attempts: the first, and the one after the last.
        q: written: the solution, or the positions of least error, shape (n,).
        memory: a `Scratch`.

    Returns:
        Number of the last attempt, whether the goal is reached, distance [m] and angle [rad].
    """
    trial = np.empty(q.shape[0])
    least, distance, angle = np.inf, np.inf, np.inf
    attempt = attempts[0]
    for attempt in range(attempts[0], attempts[1]):
        start_at(arm, start, seed, stream, attempt, trial)
        reached, d, a = descend(chain, arm, target, goal, trial, memory)
        miss = (d / goal.position_tolerance) ** 2 + (a / goal.rotation_tolerance) ** 2
        if reached or miss < least:
            least, distance, angle = miss, d, a
            q[:] = trial
        if reached:
            unwind(arm, start, q)
            return attempt, True, distance, angle
    return attempt, False, distance, angle


@njit(cache=True, nogil=True)
def search_all(
    chain: Any, arm: Any, targets: Any, goal: Any, starts: Any, seed: int, attempts: int
) -> Any:
    """`next_solution` for many targets.

    Args:
        chain: a `ChainArrays`.
        arm: an `Arm`.
        targets: ``T_base_camera``, shape (M, 4, 4).
        goal: a `Goal`.
        starts: shape (M, n).
        seed: of the random starts.
        attempts: largest number for one target.

    Returns:
        Positions, shape (M, n), whether they reach the goal, distances [m], angles [rad], and
        numbers of random starts, shape (M,) each.
    """
    count, n = starts.shape
    memory = make_scratch(chain.columns.shape[0], n)
    qs, converged = np.empty((count, n)), np.empty(count, np.bool_)
    distances, angles = np.empty(count), np.empty(count)
    restarts = np.empty(count, np.int64)
    for i in range(count):
        span = 0, attempts_for(arm, targets[i], goal, attempts)
        restarts[i], converged[i], distances[i], angles[i] = next_solution(
            chain, arm, targets[i], goal, starts[i], seed, i, span, qs[i], memory
        )
    return qs, converged, distances, angles, restarts
