"""Joint positions for a camera pose, with Pinocchio's forward kinematics as the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError, RobotModelError
from infomap_ros.geometry import make_transform
from infomap_ros.motion.arm.inverse_kinematics import IkConfig, solve_ik, solve_ik_batch
from infomap_ros.motion.robot.robot_model import RobotModel

from .arms import (
    ARMS,
    REPOSITORY,
    errors,
    five_with_slide,
    placed_cameras,
    planar,
    random_positions,
    rover,
    serial_arm,
    seven,
    six_wide,
)

ROVER = rover()
SEVEN = seven()
TIGHT = IkConfig()


def problems(robot: RobotModel, rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    """Reachable poses, and starts that have nothing to do with them."""
    chain = robot.arm
    targets = placed_cameras(robot, random_positions(chain, rng, count))
    return targets, random_positions(chain, rng, count)


def assert_within_limits(robot: RobotModel, qs: np.ndarray) -> None:
    assert (qs >= robot.arm.lower).all()
    assert (qs <= robot.arm.upper).all()


@pytest.mark.parametrize("make", ARMS.values(), ids=ARMS)
def test_random_reachable_poses_are_reached(make, rng):
    robot = make()
    targets, starts = problems(robot, rng, 200)
    batch = solve_ik_batch(robot, targets, q_start=starts)
    distances, angles, _ = errors(robot, batch.q, targets)
    assert batch.converged.all()
    assert distances.max() <= TIGHT.position_tolerance
    assert angles.max() <= TIGHT.rotation_tolerance
    assert_within_limits(robot, batch.q)
    np.testing.assert_allclose(batch.position_errors, distances, atol=1e-12)
    np.testing.assert_allclose(batch.rotation_errors, angles, atol=1e-7)


@pytest.mark.parametrize("make", ARMS.values(), ids=ARMS)
def test_reachable_viewing_directions_are_reached_with_the_roll_free(make, rng):
    robot = make()
    targets, starts = problems(robot, rng, 100)
    rolls = Rotation.from_rotvec([[0, 0, roll] for roll in rng.uniform(-3, 3, 100)]).as_matrix()
    targets[:, :3, :3] = targets[:, :3, :3] @ rolls
    batch = solve_ik_batch(robot, targets, q_start=starts, direction_only=True)
    distances, _, directions = errors(robot, batch.q, targets)
    assert batch.converged.all()
    assert distances.max() <= TIGHT.position_tolerance
    assert directions.max() <= TIGHT.rotation_tolerance
    assert_within_limits(robot, batch.q)
    np.testing.assert_allclose(batch.rotation_errors, directions, atol=1e-7)


def test_one_target_is_solved_as_the_first_of_a_batch(rng):
    targets, starts = problems(SEVEN, rng, 20)
    for target, start in zip(targets, starts, strict=True):
        single = solve_ik(SEVEN, target, q_start=start, seed=3)
        batch = solve_ik_batch(SEVEN, target[None], q_start=start, seed=3)
        assert single.converged
        np.testing.assert_array_equal(single.q, batch.q[0])
        assert single.position_error == batch.position_errors[0]
        assert single.restarts == batch.restarts[0]


def test_the_result_depends_on_the_seed_alone(rng):
    targets, starts = problems(SEVEN, rng, 60)
    first, second = (solve_ik_batch(SEVEN, targets, q_start=starts, seed=7) for _ in range(2))
    other = solve_ik_batch(SEVEN, targets, q_start=starts, seed=8)
    np.testing.assert_array_equal(first.q, second.q)
    assert first.restarts.max() > 0
    assert (first.q != other.q).any()


def test_a_start_that_is_a_solution_is_kept(rng):
    q = random_positions(SEVEN.arm, rng, 1)[0]
    result = solve_ik(SEVEN, placed_cameras(SEVEN, q[None])[0], q_start=q)
    np.testing.assert_allclose(result.q, q, atol=1e-9)
    assert result.restarts == 0


@pytest.mark.parametrize("direction_only", [False, True])
def test_a_camera_that_looks_the_opposite_way_is_turned(direction_only):
    """The axis of half a turn is not defined, and must not lock the search."""
    robot = serial_arm("yz", [0.1, 0.1], [(-np.inf, np.inf), (-1.0, 1.0)])
    target = placed_cameras(robot, np.array([[math.pi, 0.0]]))[0]
    result = solve_ik(robot, target, q_start=[0.0, 0.0], direction_only=direction_only)
    assert result.converged


@pytest.mark.parametrize("turns", [-2, 0, 3])
def test_a_continuous_joint_stays_within_half_a_turn_of_its_start(turns, rng):
    targets, starts = problems(SEVEN, rng, 30)
    starts[:, 0] += 2.0 * math.pi * turns
    batch = solve_ik_batch(SEVEN, targets, q_start=starts)
    assert batch.converged.all()
    assert np.abs(batch.q[:, 0] - starts[:, 0]).max() <= math.pi + 1e-9


def test_a_joint_that_turns_twice_takes_the_turn_nearest_to_its_start(rng):
    robot = six_wide()
    targets, starts = problems(robot, rng, 50)
    batch = solve_ik_batch(robot, targets, q_start=starts)
    for sign in (-1.0, 1.0):
        other = batch.q + 2.0 * math.pi * sign
        allowed = (other >= robot.arm.lower) & (other <= robot.arm.upper)
        nearer = np.abs(other - starts) < np.abs(batch.q - starts) - 1e-9
        assert not (allowed & nearer).any()


def test_a_refused_solution_is_not_the_last():
    target = placed_cameras(ROVER, np.array([[0.3, 0.2, 1.0, -0.5]]))[0]
    for sign in (1.0, -1.0):
        config = IkConfig(position_tolerance=0.01, rotation_tolerance=0.05)
        result = solve_ik(ROVER, target, config=config, is_valid=lambda q, s=sign: s * q[2] > 0.0)
        assert result.converged
        assert sign * result.q[2] > 0.0


def test_solutions_that_are_all_refused_are_counted():
    target = placed_cameras(ROVER, np.array([[0.3, 0.2, 1.0, -0.5]]))[0]
    seen = []
    result = solve_ik(ROVER, target, is_valid=lambda q: bool(seen.append(q)))
    assert not result.converged
    assert len(seen) > 1
    assert result.reason == f"solutions found: {len(seen)}, none of them valid"
    np.testing.assert_allclose(
        placed_cameras(ROVER, np.array(seen))[:, :3, 3], [target[:3, 3]] * len(seen), atol=1e-4
    )


def test_a_target_out_of_reach_says_how_far_it_is():
    """The arm's pan joint stands at (0.1, 0, 0.11) m."""
    target = make_transform(np.eye(3), [3.1, 0.0, 0.11])
    result = solve_ik(ROVER, target)
    assert not result.converged
    assert result.restarts == 0
    assert "out of reach: 3.00 m from joint 'arm_pan_joint', the arm extends 0.8" in result.reason


def test_a_camera_fixed_on_the_base_is_said_to_have_no_arm():
    joints = '<parent link="base"/><child link="camera"/><origin xyz="0 0 0.5"/>'
    links = '<link name="base"/><link name="camera"/>'
    text = f'<robot name="r">{links}<joint name="j" type="fixed">{joints}</joint></robot>'
    robot = RobotModel.from_urdf(text, base_frame="base", camera_frame="camera")
    result = solve_ik(robot, make_transform(np.eye(3), [2.0, 0.0, 0.5]))
    assert not result.converged
    assert result.reason == "no arm moves the camera, which is 2.00 m away"


def test_what_is_said_to_be_out_of_reach_is(rng):
    """The farthest of many random camera positions is within the extent that is stated."""
    for make in ARMS.values():
        robot = make()
        cameras = robot.arm.camera_pose(random_positions(robot.arm, rng, 20_000))[:, :3, 3]
        target = make_transform(np.eye(3), [50.0, 0.0, 0.0])
        extent = float(solve_ik(robot, target).reason.split("extends ")[1].removesuffix(" m"))
        shoulder = robot.arm.arrays.placements[0][:, 3]
        assert np.linalg.norm(cameras - shoulder, axis=1).max() <= extent + 0.005


def test_a_position_error_is_stated():
    """The planar arm moves its camera in the plane y = 2 cm."""
    target = make_transform(np.eye(3), [0.0, 0.05, 0.7])
    config = IkConfig(position_tolerance=0.01, rotation_tolerance=3.1)
    result = solve_ik(planar(), target, config=config)
    assert not result.converged
    assert result.reason == "position off by 3.0 cm"
    assert result.position_error == pytest.approx(0.03, abs=1e-4)


def test_a_joint_at_its_limit_is_named():
    robot = serial_arm("zyyzyz", [0.1, 0.4, 0.4, 0.1, 0.1, 0.1], [(-1.0, 1.0), *[(-3, 3)] * 5])
    free = serial_arm("zyyzyz", [0.1, 0.4, 0.4, 0.1, 0.1, 0.1], [(-3.0, 3.0), *[(-3, 3)] * 5])
    target = placed_cameras(free, np.array([[1.4, 1.2, 0.2, 0.1, 0.3, 0.2]]))[0]
    assert solve_ik(free, target).converged
    narrow = solve_ik(robot, target)
    assert not narrow.converged
    assert "at the limits of joint 'joint0'" in narrow.reason


def test_four_joints_come_as_near_as_tolerances_ask(rng):
    """Targets a little beside what four joints reach exactly are reached within tolerances."""
    config = IkConfig(position_tolerance=0.02, rotation_tolerance=0.05)
    targets, starts = problems(ROVER, rng, 100)
    for target in targets:
        shift = rng.normal(size=3)
        target[:3, 3] += 0.01 * shift / np.linalg.norm(shift)
    exact = solve_ik_batch(ROVER, targets, q_start=starts, direction_only=True)
    near = solve_ik_batch(ROVER, targets, q_start=starts, direction_only=True, config=config)
    distances, _, directions = errors(ROVER, near.q, targets)
    assert exact.converged.mean() < 0.1
    assert near.converged.all()
    assert distances.max() <= 0.02
    assert directions.max() <= 0.05
    assert_within_limits(ROVER, near.q)


def test_the_least_error_is_that_of_another_optimizer(rng):
    """Targets that four joints cannot reach: scipy's trust region from 40 starts does no better."""
    config = IkConfig(position_tolerance=0.01, rotation_tolerance=0.02)
    weights = np.array([1 / 0.01] * 3 + [1 / 0.02] * 3)
    targets, _ = problems(ROVER, rng, 5)
    targets[:, :3, 3] += 0.08
    chain = ROVER.arm

    def residuals(q: np.ndarray, target: np.ndarray) -> np.ndarray:
        pose = chain.camera_pose(q)
        turn = Rotation.from_matrix(target[:3, :3] @ pose[:3, :3].T).as_rotvec()
        return weights * np.concatenate([target[:3, 3] - pose[:3, 3], turn])

    batch = solve_ik_batch(ROVER, targets, config=config)
    for target, q in zip(targets, batch.q, strict=True):
        least = min(
            2.0
            * least_squares(
                residuals, start, bounds=(chain.lower, chain.upper), args=(target,)
            ).cost
            for start in random_positions(chain, rng, 40)
        )
        assert np.sum(residuals(q, target) ** 2) <= 1.05 * least


def test_a_camera_fixed_to_the_base_is_where_it_is():
    xml = (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="fixed">'
        '<parent link="a"/><child link="b"/><origin xyz="0 0 1"/></joint></robot>'
    )
    robot = RobotModel.from_urdf(xml, "b")
    assert solve_ik(robot, make_transform(np.eye(3), [0, 0, 1])).converged
    refused = solve_ik(robot, make_transform(np.eye(3), [0, 0, 2]))
    assert refused.reason == "no arm moves the camera, which is 1.00 m away"


def test_no_targets_have_no_solutions():
    batch = solve_ik_batch(ROVER, np.empty((0, 4, 4)))
    assert batch.q.shape == (0, 4)
    assert batch.converged.shape == (0,)


def test_a_start_outside_the_limits_is_moved_inside(rng):
    targets, _ = problems(ROVER, rng, 10)
    batch = solve_ik_batch(ROVER, targets, q_start=[9.0, -9.0, 9.0, 9.0], direction_only=True)
    assert batch.converged.all()
    assert_within_limits(ROVER, batch.q)


def test_a_lift_is_not_turned(rng):
    """A sliding joint at its limit is not taken for one that is a turn away."""
    robot = five_with_slide()
    target = placed_cameras(robot, np.array([[0.2, 0.3, 0.4, -0.5, 0.6]]))[0]
    result = solve_ik(robot, target, q_start=[1.0, 0.0, 0.0, 0.0, 0.0])
    assert result.converged
    assert 0.2 <= result.q[0] <= 1.0


@given(
    arrays(
        np.float64,
        st.sampled_from([(4, 4), (3, 4), (4,), (2, 4, 4)]),
        elements=st.floats(allow_nan=True, allow_infinity=True, width=32),
    )
)
@settings(max_examples=100, deadline=None)
def test_what_is_no_pose_is_refused(target):
    with pytest.raises(InvalidInputError, match="T_base_camera"):
        solve_ik(ROVER, target)


@given(st.integers(0, 4), st.sampled_from([math.nan, math.inf, 2.0]), st.integers(0, 3))
@settings(max_examples=30, deadline=None)
def test_the_target_of_a_batch_that_is_no_pose_is_named(index, value, row):
    targets = np.tile(np.eye(4), (5, 1, 1))
    targets[index, row, row] = value
    with pytest.raises(InvalidInputError, match=rf"T_base_cameras\[{index}\]"):
        solve_ik_batch(ROVER, targets)


def test_a_reflection_is_no_rotation():
    with pytest.raises(InvalidInputError, match="reflection"):
        solve_ik(ROVER, np.diag([1.0, 1.0, -1.0, 1.0]))


@pytest.mark.parametrize(
    "start", [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0, math.nan], "x", np.zeros((2, 4))]
)
def test_malformed_starts_are_refused(start):
    with pytest.raises(InvalidInputError, match="q_start"):
        solve_ik(ROVER, np.eye(4), q_start=start)


@pytest.mark.parametrize("field", [{"position_tolerance": 0.0}, {"restarts": -1}])
def test_impossible_configurations_are_refused(field):
    with pytest.raises(ConfigError, match=next(iter(field))):
        IkConfig(**field)


def test_a_robot_without_a_camera_cannot_be_solved_for():
    with pytest.raises(RobotModelError, match="no camera frame"):
        solve_ik(RobotModel.from_urdf(REPOSITORY / "config/rover.urdf"), np.eye(4))
