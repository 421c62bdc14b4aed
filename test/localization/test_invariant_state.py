"""The filter's state against naive copies of its covariance, and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import make_transform, perturb_transform
from infomap_ros.localization.filter.invariant_state import InvariantState
from infomap_ros.localization.filter.lie import exponential, left_jacobian
from infomap_ros.localization.filter.shared_errors import invariant_difference
from test.localization.fiducial_scene import wall


def some_pose(rng: np.random.Generator) -> np.ndarray:
    return make_transform(
        Rotation.from_rotvec(rng.normal(0, 0.6, 3)).as_matrix(), rng.normal(0, 2.0, 3)
    )


def some_state(rng: np.random.Generator, count: int = 5, poses: int = 3) -> InvariantState:
    """Fiducials and kept poses in mixed order, fully correlated."""
    state = InvariantState(some_pose(rng), np.diag(rng.uniform(1e-4, 1e-3, 6)), 40)
    for number in range(poses):
        state.keep_pose(10 * number)
        share = slice(count * number // poses, count * (number + 1) // poses)
        points = wall(count, rng)[share]
        noise = np.tile(1e-4 * np.eye(3), (len(points), 1, 1))
        state.add_fiducials(np.arange(count)[share], points, noise)
        root = 1e-2 * rng.normal(size=(len(state.P), 4))
        state.add_to_covariance(root, root.T)
    return state


def everything(state: InvariantState) -> dict[object, tuple[int, ...]]:
    """Rows of the covariance by what they belong to."""
    fiducials = zip(state.ids.tolist(), state.fiducial_rows(slice(None)), strict=True)
    kept = zip(state.stamps.tolist(), state.kept_rows(), strict=True)
    return {("f", number): tuple(rows) for number, rows in fiducials} | {
        ("k", stamp): tuple(rows) for stamp, rows in kept
    }


def test_removal_leaves_the_covariances_of_the_others() -> None:
    rng = np.random.default_rng(1)
    state = some_state(rng, 9, 4)
    before, P = everything(state), state.P.copy()
    state.remove_fiducials(np.isin(state.ids, [0, 4, 8]))
    state.remove_kept(np.isin(state.stamps, [10]))
    after = everything(state)
    assert len(after) == len(before) - 4
    assert len(state.P) == 9 + 3 * 6 + 6 * 3
    new = np.concatenate([np.arange(9), *(after[key] for key in after)])
    old = np.concatenate([np.arange(9), *(before[key] for key in after)])
    np.testing.assert_array_equal(state.P[np.ix_(new, new)], P[np.ix_(old, old)])


def test_a_kept_pose_has_the_errors_of_the_camera() -> None:
    rng = np.random.default_rng(2)
    state = some_state(rng)
    state.keep_pose(99)
    rows = state.kept_rows()[-1]
    np.testing.assert_array_equal(state.P[rows], state.P[:6])
    np.testing.assert_array_equal(state.P[np.ix_(rows, rows)], state.P[:6, :6])
    np.testing.assert_array_equal(state.kept[-1], state.T_map_camera)


def test_products_are_added_as_by_dense_algebra() -> None:
    rng = np.random.default_rng(3)
    state = InvariantState(np.eye(4), np.eye(6), 130)
    state.add_fiducials(
        np.arange(120), wall(120, rng), np.tile(1e-4 * np.eye(3), (120, 1, 1))
    )  # more rows than one tile
    before = state.P.copy()
    root = rng.normal(size=(len(before), 7))
    state.add_to_covariance(-root, root.T)
    np.testing.assert_allclose(state.P, before - root @ root.T, atol=1e-12)
    np.testing.assert_array_equal(state.P, state.P.T)


def test_motion_noise_is_that_of_finite_differences() -> None:
    """How an error of the motion shows in the invariant errors of camera and fiducials."""
    rng = np.random.default_rng(4)
    state = some_state(rng)
    motion = make_transform(Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix(), [0.3, 0.1, 0.2])
    after = state.T_map_camera @ motion
    noise = state.motion_noise(after, state.T_map_camera[:3, :3])
    step = 1e-6
    for column in range(6):
        eta = step * np.eye(6)[column]
        true = state.T_map_camera @ perturb_transform(motion, eta)
        error = invariant_difference(true, after)
        np.testing.assert_allclose(noise[:6, column], error / step, atol=1e-4)
        # The fiducials stay where they are, so xi_f = J^-1 (f - Exp(theta) f).
        theta = Rotation.from_rotvec(error[3:])
        off = (state.positions - theta.apply(state.positions)) / step
        rows = state.fiducial_rows(slice(None))
        np.testing.assert_allclose(noise[rows, column], off, atol=1e-4)


def test_a_turn_of_the_camera_alone_leaves_the_fiducials() -> None:
    """A large turn in the direction of the motion's noise moves nothing but the camera."""
    rng = np.random.default_rng(5)
    state = some_state(rng)
    positions = state.positions.copy()
    noise = state.motion_noise(state.T_map_camera, np.eye(3))
    state.correct(noise @ [0.0, 0.0, 0.0, 0.4, -0.7, 0.2])
    np.testing.assert_allclose(state.positions, positions, atol=1e-12)


def moved_pose(pose: np.ndarray, error: np.ndarray) -> np.ndarray:
    """The pose, shape (4, 4), with an error (xi, theta), shape (6,), taken out."""
    turn = exponential(error[3:])
    result = pose.copy()
    result[:3, :3] = turn @ pose[:3, :3]
    result[:3, 3] = turn @ pose[:3, 3] + left_jacobian(error[3:]) @ error[:3]
    return result


def test_a_rigid_error_moves_everything_rigidly() -> None:
    rng = np.random.default_rng(6)
    state = some_state(rng)
    error6 = np.array([0.3, -0.2, 0.1, 0.2, 0.5, -0.3])
    old = (state.positions.copy(), state.kept.copy(), state.T_map_camera.copy())
    error = np.zeros(len(state.P))
    error[:6] = error6
    error[state.fiducial_rows(slice(None))] = error6[:3]
    error[state.kept_rows()] = error6
    state.correct(error)
    moved = moved_pose(np.eye(4), error6)
    np.testing.assert_allclose(state.positions, old[0] @ moved[:3, :3].T + moved[:3, 3])
    np.testing.assert_allclose(state.kept, moved @ old[1], atol=1e-12)
    np.testing.assert_allclose(state.T_map_camera, moved @ old[2], atol=1e-12)


def test_invariant_difference_undoes_moved_pose() -> None:
    rng = np.random.default_rng(7)
    pose, error = some_pose(rng), rng.normal(0, 0.5, 6)
    np.testing.assert_allclose(
        invariant_difference(moved_pose(pose, error), pose), error, atol=1e-12
    )


def test_a_resumed_state_is_the_same() -> None:
    rng = np.random.default_rng(8)
    state = some_state(rng)
    again = InvariantState.resume(state.arrays(), 60)
    np.testing.assert_array_equal(again.P, state.P)
    assert everything(again) == everything(state)


def test_a_state_that_does_not_fit_is_refused() -> None:
    state = some_state(np.random.default_rng(9))
    with pytest.raises(InvalidInputError, match="covariance"):
        InvariantState.resume(state.arrays(), 5)
