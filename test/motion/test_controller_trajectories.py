from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from infomap_ros.errors import ConfigError, InvalidInputError, RobotModelError
from infomap_ros.motion.arm.controller_trajectories import (
    knot_velocities,
    peak_speeds,
    read_controllers,
    split_trajectory,
    stopping_path,
)
from infomap_ros.motion.robot.mechanism import JointLimits
from infomap_ros.motion.route import ArmPath

TABLE = {"torso": ("lift",), "arm": ("pan", "tilt")}
LIMITS = {
    "lift": JointLimits("lift", 0.0, 0.35, 0.1),
    "pan": JointLimits("pan", -3.0, 3.0, 1.0),
    "tilt": JointLimits("tilt", -1.5, 1.5, 2.0),
}
PRESENT = {"lift": 0.1, "pan": 0.0, "tilt": 0.5, "wheel": 7.0}


def trapezoid(length: float, speed: float, growth: float, period: float) -> ArmPath:
    """One joint from 0 to `length` and back, at rest in between, in knots of constant growth."""
    rise, top = speed / growth, length / speed - speed / growth
    ends = (0.0, rise, rise + top, 2 * rise + top)
    knots = np.concatenate([np.arange(a, b, period) for a, b in pairwise(ends)])
    times = np.append(knots, 2 * rise + top)

    def at(t: float) -> float:
        if t < rise:
            return 0.5 * growth * t**2
        if t < rise + top:
            return 0.5 * growth * rise**2 + speed * (t - rise)
        return length - 0.5 * growth * (2 * rise + top - t) ** 2

    there = np.array([at(t) for t in times])
    back = np.concatenate([there, length - there[1:]])
    return ArmPath(("pan",), back[:, None], np.concatenate([times, times[-1] + times[1:]]))


def test_controllers_are_read() -> None:
    table = ["torso: lift", "arm_controller: pan, tilt roll"]
    assert read_controllers(table) == {
        "torso": ("lift",),
        "arm_controller": ("pan", "tilt", "roll"),
    }


@pytest.mark.parametrize(
    "table", [["arm"], ["arm:"], [": pan"], ["a: pan", "b: pan"], ["a: x"] * 2]
)
def test_impossible_tables_are_refused(table: list[str]) -> None:
    with pytest.raises(ConfigError, match="controllers"):
        read_controllers(table)


def test_each_controller_gets_all_of_its_joints_and_no_other() -> None:
    path = ArmPath(("tilt", "lift"), np.array([[0.5, 0.1], [0.9, 0.2]]), np.array([0.0, 3.0]))
    torso, arm = split_trajectory(path, TABLE, PRESENT, LIMITS)
    assert (torso.controller, torso.joints) == ("torso", ("lift",))
    assert (arm.controller, arm.joints) == ("arm", ("pan", "tilt"))
    np.testing.assert_allclose(arm.positions, [[0.0, 0.5], [0.0, 0.9]])
    np.testing.assert_allclose(torso.times, arm.times)
    assert not arm.velocities[-1].any()


def test_a_controller_without_a_moving_joint_gets_nothing() -> None:
    path = ArmPath(("lift",), np.array([[0.1], [0.2]]), np.array([0.0, 3.0]))
    assert [part.controller for part in split_trajectory(path, TABLE, PRESENT, LIMITS)] == ["torso"]


def test_velocities_of_a_trapezoid_are_its_own() -> None:
    path = trapezoid(1.0, 0.5, 1.0, 0.05)
    velocities = knot_velocities(path.positions, path.times)
    spline = CubicHermiteSpline(path.times, path.positions, velocities)
    inner = 0.5 * (path.times[1:] + path.times[:-1])
    accelerations = np.abs(spline(inner, 2))
    assert np.abs(spline(np.linspace(0, path.times[-1], 2000), 1)).max() == pytest.approx(0.5)
    assert accelerations.max() < 1.0 + 1e-6
    assert velocities[len(path.times) // 2, 0] == pytest.approx(0.0, abs=1e-9)  # it turns there


def test_the_cubic_stays_between_knots(rng: np.random.Generator) -> None:
    times = np.cumsum(rng.uniform(0.05, 0.5, 40))
    positions = np.cumsum(rng.normal(size=(40, 3)), axis=0)
    spline = CubicHermiteSpline(times, positions, knot_velocities(positions, times))
    for first, last, low, high in zip(times[:-1], times[1:], positions[:-1], positions[1:],
                                      strict=True):  # fmt: skip
        between = spline(np.linspace(first, last, 30))
        assert (between >= np.minimum(low, high) - 1e-9).all()
        assert (between <= np.maximum(low, high) + 1e-9).all()


def test_peak_speeds_are_those_of_the_cubic(rng: np.random.Generator) -> None:
    times = np.cumsum(rng.uniform(0.05, 0.5, 30))
    positions, velocities = rng.normal(size=(30, 2)), rng.normal(size=(30, 2))
    spline = CubicHermiteSpline(times, positions, velocities)
    fine = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(times)])
    np.testing.assert_allclose(
        peak_speeds(positions, velocities, times), np.abs(spline(fine, 1)).max(axis=0), rtol=1e-3
    )


def test_no_joint_is_faster_than_it_can() -> None:
    path = ArmPath(("pan", "lift"), np.array([[0.0, 0.1], [2.0, 0.15]]), np.array([0.0, 0.5]))
    torso, arm = split_trajectory(path, TABLE, PRESENT, LIMITS)
    assert peak_speeds(arm.positions, arm.velocities, arm.times)[0] == pytest.approx(1.0)
    assert peak_speeds(torso.positions, torso.velocities, torso.times)[0] < 0.1
    assert torso.times[-1] == arm.times[-1] == pytest.approx(3.0)


def test_a_start_elsewhere_is_gone_to_in_time() -> None:
    path = ArmPath(("pan",), np.array([[0.6], [0.7]]), np.array([0.0, 1.0]))
    (arm,) = split_trajectory(path, TABLE, PRESENT, LIMITS)
    np.testing.assert_allclose(arm.positions[:, 0], [0.0, 0.6, 0.7])
    assert arm.times[0] == 0.0
    assert arm.times[1] == pytest.approx(0.9)
    assert peak_speeds(arm.positions, arm.velocities, arm.times)[0] <= 1.0 + 1e-9


def test_what_cannot_be_carried_out_is_refused() -> None:
    def split(names: tuple[str, ...], knots: object, times: object) -> None:
        path = ArmPath(names, np.array(knots, dtype=float), np.array(times, dtype=float))
        split_trajectory(path, TABLE, PRESENT, LIMITS)

    with pytest.raises(RobotModelError, match="no controller has the joint finger"):
        split(("pan", "finger"), [[0, 0], [1, 0]], [0, 9])
    with pytest.raises(InvalidInputError, match=r"'lift' at 0\.5000 is outside 0 to 0\.35"):
        split(("lift",), [[0.1], [0.5]], [0, 9])
    with pytest.raises(InvalidInputError, match="times do not increase"):
        split(("pan",), [[0], [1]], [1, 1])
    with pytest.raises(RobotModelError, match="joint_states does not hold tilt"):
        split_trajectory(
            ArmPath(("pan",), np.array([[0.0], [1.0]]), np.array([0.0, 9.0])),
            TABLE, {"pan": 0.0}, LIMITS,
        )  # fmt: skip


def test_a_stop_slows_down_within_half_a_second() -> None:
    stop = stopping_path(("pan", "tilt"), np.array([0.2, 0.3]), np.array([0.6, -0.2]))
    assert stop.times[0] == pytest.approx(0.3)
    np.testing.assert_allclose(stop.positions[0], [0.2 + 0.09, 0.3 - 0.03])
    assert stopping_path(("pan",), np.zeros(1), np.zeros(1)).times[0] == 0.1
    assert stopping_path(("pan",), np.zeros(1), np.full(1, 9.0)).times[0] == 0.5
