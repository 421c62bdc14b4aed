"""Trajectories as the controllers of a robot want them: each its own joints, with velocities.

Controllers as ros2_control's joint_trajectory_controller go between two knots along the cubic that
has the given positions and velocities. No accelerations are given: along knots of constant
acceleration, which `trajectory` makes, that cubic is the planned motion itself, while a quintic
through accelerations that jump would exceed them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import ConfigError, InvalidInputError, RobotModelError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.mechanism import JointLimits
from infomap_ros.motion.route import ArmPath

_UNKNOWN_SPEED = 0.5  # [rad/s or m/s] of joints whose description gives none
_SAME = 1e-3  # [rad or m] by which a position may be off a limit, or a start off where a joint is
_DECELERATION = 2.0  # [rad/s^2 or m/s^2] of a stop
_SHORTEST_STOP, _LONGEST_STOP = 0.1, 0.5  # [s]


@dataclass(frozen=True, eq=False)
class ControllerTrajectory:
    """What one controller is to do.

    Attributes:
        controller: its name.
        joints: its n joints.
        positions: knots, shape (K, n) [rad or m].
        velocities: at the knots, shape (K, n) [rad/s or m/s]; zero at the end.
        times: of the knots from the start, increasing, shape (K,) [s].
    """

    controller: str
    joints: tuple[str, ...]
    positions: FloatArray
    velocities: FloatArray
    times: FloatArray


def read_controllers(table: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """The joints of each controller, by its name.

    Args:
        table: one controller each, as ``"arm_controller: shoulder_joint, elbow_joint"``.

    Raises:
        ConfigError: an entry has no name or no joints, or a joint has two controllers.
    """
    controllers: dict[str, tuple[str, ...]] = {}
    for entry in table:
        name, _, joints = entry.partition(":")
        found = tuple(joints.replace(",", " ").split())
        if not name.strip() or not found or name.strip() in controllers:
            expected = "each controller once, as 'controller: joint, joint'"
            raise ConfigError("controllers", entry, expected)
        controllers[name.strip()] = found
    joints_of_all = [joint for joints in controllers.values() for joint in joints]
    twice = sorted({joint for joint in joints_of_all if joints_of_all.count(joint) > 1})
    if twice:
        raise ConfigError("controllers", list(table), f"joint {twice[0]} of one controller only")
    return controllers


def split_trajectory(
    path: ArmPath,
    controllers: Mapping[str, Sequence[str]],
    present: Mapping[str, float],
    limits: Mapping[str, JointLimits],
) -> list[ControllerTrajectory]:
    """Give each controller its part of a trajectory: all of its joints and no other.

    Joints of a controller that the trajectory leaves out stay where they are. All parts begin and
    end together. They begin where the joints are, with the time that it takes to the first knot;
    where a joint would be faster than it can, all take longer.

    Args:
        path: of the arm.
        controllers: joints of each controller, by its name.
        present: where the joints are [rad or m].
        limits: of joints, by name; others have none.

    Raises:
        InvalidInputError: no knots, times that do not increase, or a knot beyond a joint's limits.
        RobotModelError: a joint belongs to no controller, or is not in the joint states.
    """
    _check(path, limits)
    concerned = {
        name: tuple(joints)
        for name, joints in controllers.items()
        if not set(joints).isdisjoint(path.joint_names)
    }
    joints = [joint for names in concerned.values() for joint in names]
    if missing := sorted(set(path.joint_names) - set(joints)):
        raise RobotModelError(f"no controller has the joint {', '.join(missing)}")
    if unknown := sorted(set(joints) - set(present)):
        raise RobotModelError(f"joint_states does not hold {', '.join(unknown)}")
    start = np.array([present[name] for name in joints])
    knots = np.repeat(start[None], len(path.positions), axis=0)
    knots[:, [joints.index(name) for name in path.joint_names]] = path.positions
    fastest = np.array([_speed(limits.get(name)) for name in joints])
    positions, times = _begun_from(start, knots, path.times, fastest)
    velocities = knot_velocities(positions, times)
    known = np.array([np.isfinite(limits[name].velocity) if name in limits else False
                      for name in joints])  # fmt: skip
    if known.any():
        peaks = peak_speeds(positions, velocities, times)[known] / fastest[known]
        slower = max(1.0, float(peaks.max(initial=0.0)))
        times, velocities = times * slower, velocities / slower
    parts, first = [], 0
    for name, names in concerned.items():
        mine = slice(first, first := first + len(names))
        parts.append(
            ControllerTrajectory(name, names, positions[:, mine], velocities[:, mine], times)
        )
    return parts


def stopping_path(
    joint_names: Sequence[str], positions: FloatArray, velocities: FloatArray
) -> ArmPath:
    """One knot at which joints stand that move now: a stop that every controller accepts.

    Args:
        joint_names: n joints.
        positions: now, shape (n,) [rad or m].
        velocities: now, shape (n,) [rad/s or m/s].
    """
    fastest = float(np.abs(velocities).max(initial=0.0))
    time = min(max(fastest / _DECELERATION, _SHORTEST_STOP), _LONGEST_STOP)
    end = np.asarray(positions) + 0.5 * time * np.asarray(velocities)
    return ArmPath(tuple(joint_names), end[None], np.array([time]))


def knot_velocities(positions: FloatArray, times: FloatArray) -> FloatArray:
    """Velocities at knots of a motion that begins and ends at rest, shape (K, n).

    Between knots of constant acceleration they are exact. Else they are those of the parabola
    through each knot and its neighbors, limited so that the cubic between two knots does not leave
    what lies between them: F. N. Fritsch and R. E. Carlson, Monotone Piecewise Cubic Interpolation,
    SIAM J. Numer. Anal. 17 (1980), doi:10.1137/0717021.

    Args:
        positions: shape (K, n) [rad or m].
        times: increasing, shape (K,) [s].
    """
    velocities = np.zeros_like(positions)
    if len(times) < 2:
        return velocities
    steps = np.diff(times)[:, None]
    slopes = np.diff(positions, axis=0) / steps
    exact = velocities.copy()
    for knot, slope in enumerate(slopes):
        exact[knot + 1] = 2.0 * slope - exact[knot]
    largest = np.abs(slopes).max(axis=0)
    if (np.abs(exact) <= 2.0 * largest + 1e-9).all() and np.allclose(exact[-1], 0.0, atol=1e-6):
        exact[-1] = 0.0
        return exact
    before, after = slopes[:-1], slopes[1:]
    inner = (before * steps[1:] + after * steps[:-1]) / (steps[1:] + steps[:-1])
    bound = 3.0 * np.minimum(np.abs(before), np.abs(after)) * (before * after > 0.0)
    velocities[1:-1] = np.clip(inner, -bound, bound)
    return velocities


def peak_speeds(positions: FloatArray, velocities: FloatArray, times: FloatArray) -> FloatArray:
    """Largest speed of each joint along the cubics between knots, shape (n,) [rad/s or m/s]."""
    peaks = np.abs(velocities).max(axis=0)
    if len(times) < 2:
        return peaks
    slopes = np.diff(positions, axis=0) / np.diff(times)[:, None]
    first, last = velocities[:-1], velocities[1:]
    # The speed along a cubic is first (1 - s)^2 + last s^2 + 2 s (1 - s) middle, s from 0 to 1.
    middle = 3.0 * slopes - first - last
    bend = first + last - 2.0 * middle
    with np.errstate(divide="ignore", invalid="ignore"):
        place = (first - middle) / bend
        turning = first - (first - middle) * place
    inside = (place > 0.0) & (place < 1.0)
    return np.maximum(peaks, np.where(inside, np.abs(turning), 0.0).max(axis=0))


def _check(path: ArmPath, limits: Mapping[str, JointLimits]) -> None:
    if not len(path.positions):
        raise InvalidInputError("arm trajectory", "has no points")
    if path.times[0] < 0.0 or (np.diff(path.times) <= 0.0).any():
        raise InvalidInputError("arm trajectory", "times do not increase")
    for name, column in zip(path.joint_names, path.positions.T, strict=True):
        limit = limits.get(name)
        low, high = float(column.min()), float(column.max())
        if limit is not None and (low < limit.lower - _SAME or high > limit.upper + _SAME):
            worst = low if low < limit.lower - _SAME else high
            problem = f"'{name}' at {worst:.4f} is outside {limit.lower:g} to {limit.upper:g}"
            raise InvalidInputError("arm trajectory", problem)


def _speed(limit: JointLimits | None) -> float:
    known = limit is not None and np.isfinite(limit.velocity)
    return limit.velocity if limit is not None and known else _UNKNOWN_SPEED


def _begun_from(
    start: FloatArray, knots: FloatArray, times: FloatArray, fastest: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Knots and times of a motion that begins where the joints are, at time 0."""
    away = np.abs(knots[0] - start)
    if away.max() <= _SAME and times[0] == 0.0 and len(times) > 1:
        return knots, times
    # From rest to rest the largest speed of a cubic is 1.5 times its mean.
    needed = 1.5 * float((away / fastest).max())
    if away.max() <= _SAME:
        needed = 0.0
    later = max(0.0, needed - float(times[0]))
    if times[0] + later <= 0.0:
        later = _SHORTEST_STOP
    return np.vstack([start[None], knots]), np.concatenate([[0.0], times + later])
