"""Transforms against scipy, finite differences and identities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    check_covariance,
    check_transform,
    check_transforms,
    interpolate_transforms,
    invert_transform,
    make_transform,
    perturb_transform,
    quaternion_from_transform,
    skew,
    transform_from_quaternion,
    transform_points,
)


def random_transform(rng: np.random.Generator) -> np.ndarray:
    return make_transform(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))


def test_points_move_as_homogeneous_coordinates_say(rng):
    transform = random_transform(rng)
    points = rng.normal(size=(4, 5, 3))
    homogeneous = np.concatenate([points, np.ones((4, 5, 1))], axis=-1)
    expected = np.einsum("ij,...j->...i", transform, homogeneous)[..., :3]
    np.testing.assert_allclose(transform_points(transform, points), expected, atol=1e-14)


def test_composition_takes_points_through_both(rng):
    T_a_b, T_b_c = random_transform(rng), random_transform(rng)
    points = rng.normal(size=(7, 3))
    np.testing.assert_allclose(
        transform_points(T_a_b @ T_b_c, points),
        transform_points(T_a_b, transform_points(T_b_c, points)),
        atol=1e-14,
    )


def test_inverse_is_the_matrix_inverse(rng):
    transform = random_transform(rng)
    np.testing.assert_allclose(invert_transform(transform), np.linalg.inv(transform), atol=1e-14)


def test_quaternion_order_is_x_y_z_w():
    half = np.sqrt(0.5)
    transform = transform_from_quaternion([0.0, 0.0, half, half], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(transform_points(transform, [1.0, 0.0, 0.0]), [1.0, 3.0, 3.0])


def test_quaternion_round_trip_up_to_sign(rng):
    for _ in range(50):
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        back = quaternion_from_transform(transform_from_quaternion(quaternion, np.zeros(3)))
        assert back[3] >= 0.0
        np.testing.assert_allclose(back, quaternion * np.sign(quaternion[3]), atol=1e-12)


def test_quaternion_of_a_message_is_normalized(rng):
    quaternion = np.array([0.1, -0.7, 0.2, 0.6])
    quaternion *= 1.005 / np.linalg.norm(quaternion)
    rotation = transform_from_quaternion(quaternion, np.zeros(3))[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("quaternion", "translation", "named"),
    [
        ([0.0, 0.0, 0.0, 0.0], [0.0] * 3, "norm 0"),
        ([0.0, 0.0, 0.0, 1.02], [0.0] * 3, "norm 1.02"),
        ([0.0, 0.0, np.nan, 1.0], [0.0] * 3, "quaternion"),
        ([0.0, 0.0, 1.0], [0.0] * 3, "shape"),
        ([0.0, 0.0, 0.0, 1.0], [0.0, np.inf, 0.0], "translation"),
        ([0.0, 0.0, 0.0, 1.0], [0.0, 0.0], "translation"),
        (["a", 0.0, 0.0, 1.0], [0.0] * 3, "quaternion"),
    ],
)
def test_impossible_quaternion_or_translation_is_refused(quaternion, translation, named):
    with pytest.raises(InvalidInputError, match=named):
        transform_from_quaternion(quaternion, translation)


def test_skew_is_the_cross_product(rng):
    a, b = rng.normal(size=(2, 3))
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-15)


def test_perturbation_jacobian_by_finite_differences(rng):
    """The convention of the module: a point moves by dt - skew(R p) dtheta."""
    transform, point = random_transform(rng), rng.normal(size=3)
    step = 1e-6
    numeric = np.empty((3, 6))
    for i in range(6):
        delta = step * np.eye(6)[i]
        ahead = transform_points(perturb_transform(transform, delta), point)
        behind = transform_points(perturb_transform(transform, -delta), point)
        numeric[:, i] = (ahead - behind) / (2.0 * step)
    analytic = np.hstack([np.eye(3), -skew(transform[:3, :3] @ point)])
    np.testing.assert_allclose(numeric, analytic, atol=1e-8)


def test_large_perturbation_rotates_in_the_parent_frame(rng):
    transform = random_transform(rng)
    turned = perturb_transform(transform, [0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(
        turned[:3, 0], [-transform[1, 0], transform[0, 0], transform[2, 0]], atol=1e-15
    )
    np.testing.assert_array_equal(turned[:3, 3], transform[:3, 3])


def test_interpolation_meets_both_ends(rng):
    first, second = random_transform(rng), random_transform(rng)
    np.testing.assert_allclose(interpolate_transforms(first, second, 0.0), first, atol=1e-12)
    np.testing.assert_allclose(interpolate_transforms(first, second, 1.0), second, atol=1e-12)


def test_interpolation_turns_evenly_and_moves_straight(rng):
    first, second = random_transform(rng), random_transform(rng)
    middle = interpolate_transforms(first, second, 0.3)
    whole = Rotation.from_matrix(second[:3, :3] @ first[:3, :3].T).as_rotvec()
    part = Rotation.from_matrix(middle[:3, :3] @ first[:3, :3].T).as_rotvec()
    np.testing.assert_allclose(part, 0.3 * whole, atol=1e-12)
    np.testing.assert_allclose(middle[:3, 3], 0.7 * first[:3, 3] + 0.3 * second[:3, 3])


def test_check_transform_returns_a_copy(rng):
    transform = random_transform(rng)
    checked = check_transform(transform)
    checked[0, 3] += 1.0
    assert transform[0, 3] != checked[0, 3]


NOT_RIGID = [
    (lambda m: m * np.nan, "NaN"),
    (lambda m: m + np.diag([1e-3, 0, 0, 0]), "orthonormal"),
    (lambda m: np.diag([1.0, 1.0, -1.0, 1.0]), "reflection"),
    (lambda m: m.T + 1.0, "last row"),
]
NO_MATRIX = [
    (lambda m: m[:3], "shape"),
    (lambda m: [[1.0, 2.0], [3.0]], "array of numbers"),
]


@pytest.mark.parametrize(("change", "named"), [*NOT_RIGID, *NO_MATRIX])
def test_what_is_not_rigid_is_refused_by_name(change, named):
    with pytest.raises(InvalidInputError, match=named) as caught:
        check_transform(change(np.eye(4)), name="T_map_camera")
    assert caught.value.name == "T_map_camera"


@pytest.mark.parametrize(("change", "named"), NOT_RIGID)
def test_the_first_of_many_that_is_not_rigid_is_named(change, named, rng):
    transforms = np.array([random_transform(rng) for _ in range(4)])
    np.testing.assert_array_equal(check_transforms(transforms), transforms)
    transforms[2:] = change(np.eye(4))
    with pytest.raises(InvalidInputError, match=named) as caught:
        check_transforms(transforms, name="poses")
    assert caught.value.name == "poses[2]"


@pytest.mark.parametrize("transforms", [np.eye(4), np.zeros((2, 3, 4)), 1.0, "x"])
def test_what_is_no_stack_of_transforms_is_refused(transforms):
    with pytest.raises(InvalidInputError, match="transforms"):
        check_transforms(transforms)


def test_check_covariance_accepts_a_semidefinite_one(rng):
    factor = rng.normal(size=(6, 2))
    covariance = factor @ factor.T
    np.testing.assert_allclose(check_covariance(covariance, 6), covariance, atol=1e-15)
    np.testing.assert_array_equal(check_covariance(np.zeros((3, 3)), 3), np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("covariance", "named"),
    [
        (np.eye(5), "shape"),
        (np.full((6, 6), np.inf), "NaN"),
        (np.triu(np.ones((6, 6))), "symmetric"),
        (np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1e-3]), "negative eigenvalue -0.001"),
        ([[1.0], [2.0, 3.0]], "array of numbers"),
    ],
)
def test_what_is_no_covariance_is_refused_by_name(covariance, named):
    with pytest.raises(InvalidInputError, match=named):
        check_covariance(covariance, 6)


def test_a_single_quaternion_becomes_to_the_bit_what_scipy_makes_of_many(rng):
    quaternions = rng.normal(size=(2000, 4))
    quaternions *= rng.uniform(0.995, 1.005, (2000, 1)) / np.linalg.norm(
        quaternions, axis=1, keepdims=True
    )
    matrices = [transform_from_quaternion(one, np.zeros(3))[:3, :3] for one in quaternions]
    np.testing.assert_array_equal(matrices, Rotation.from_quat(quaternions).as_matrix())
