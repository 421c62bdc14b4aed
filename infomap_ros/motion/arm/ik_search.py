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
