"""Compiled search for joint positions from many starts; see `inverse_kinematics`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.motion.arm.ik_kernels import descend, make_scratch

_TURN = 2.0 * math.pi


class Arm(NamedTuple):
    """What a search has to know of a chain besides its `ChainArrays`.

    Attributes:
        lower: limits [rad or m], shape (n,).
        upper: limits [rad or m], shape (n,).
        prismatic: slides, shape (n,).
        speeds: by which ways are compared [rad/s or m/s], finite, shape (n,).
        low: from where random starts are drawn, finite, shape (n,).
        high: up to where, shape (n,).
        root: origin of the first joint [m], shape (3,).
        reach: no camera is farther from it [m].
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    prismatic: NDArray[np.bool_]
    speeds: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    root: NDArray[np.float64]
    reach: float


class Found(NamedTuple):
    """What a batch of searches is to fill, one row per target.

    Attributes:
        q: positions, shape (M, n).
        converged: shape (M,).
        distances: [m], shape (M,).
        angles: [rad], shape (M,).
        restarts: shape (M,).
    """

    q: NDArray[np.float64]
    converged: NDArray[np.bool_]
    distances: NDArray[np.float64]
    angles: NDArray[np.float64]
    restarts: NDArray[np.int64]


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
def way_between(arm: Any, start: Any, q: Any) -> float:
    """Time [s] that the slowest joint needs."""
    longest = 0.0
    for j in range(q.shape[0]):
        longest = max(longest, abs(q[j] - start[j]) / arm.speeds[j])
    return longest


@njit(cache=True, nogil=True)
def out_of_reach(arm: Any, target: Any, tolerance: float) -> bool:
    """Whether the target is farther from the first joint than the stretched arm's camera."""
    square = 0.0
    for i in range(3):
        square += (target[i, 3] - arm.root[i]) ** 2
    return math.sqrt(square) > arm.reach + tolerance


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
        reached, d, a = descend(
            chain, arm.lower, arm.upper, arm.prismatic, target, goal, trial, memory
        )
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
    chain: Any,
    arm: Any,
    targets: Any,
    goal: Any,
    starts: Any,
    seed: int,
    attempts: int,
    wanted: int,
    span: tuple[int, int],
    found: Any,
) -> None:
    """Solve the targets [span[0], span[1]); of `wanted` solutions the nearest to the start stays.

    Args:
        chain: a `ChainArrays`.
        arm: an `Arm`.
        targets: ``T_base_camera``, shape (M, 4, 4).
        goal: a `Goal`.
        starts: shape (M, n).
        seed: of the random starts.
        attempts: largest number for one target.
        wanted: number of solutions to find.
        span: which targets.
        found: a `Found`, written.
    """
    n = starts.shape[1]
    memory = make_scratch(chain.columns.shape[0], n)
    q = np.empty(n)
    for i in range(span[0], span[1]):
        hopeless = out_of_reach(arm, targets[i], goal.position_tolerance)
        last = 1 if hopeless else attempts
        after, count, shortest = 0, 0, np.inf
        while after < last and count < wanted:
            attempt, reached, distance, angle = next_solution(
                chain, arm, targets[i], goal, starts[i], seed, i, (after, last), q, memory
            )
            way = way_between(arm, starts[i], q)
            if (reached and way < shortest) or after == 0:
                found.q[i] = q
                found.converged[i] = reached
                found.distances[i], found.angles[i] = distance, angle
                shortest = way if reached else np.inf
            count += reached
            found.restarts[i] = attempt
            after = attempt + 1
