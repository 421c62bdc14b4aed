"""Chains of frames agree with products of matrices and with sampled errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import (
    PoseRecord,
    TransformRecord,
    make_transform,
    perturb_transform,
)
from infomap_ros.geometry.pose_buffer import TransformTree

SECOND = 1_000_000_000


def transform(rng: np.random.Generator) -> np.ndarray:
    return make_transform(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))


def edge(parent: str, child: str, matrix: np.ndarray, stamp: int = 0, static: bool = True):
    return TransformRecord(stamp, parent, child, matrix, static)


def test_chain_is_the_product_of_its_edges(rng):
    a, b, c = (transform(rng) for _ in range(3))
    tree = TransformTree()
    tree.add_transform(edge("map", "odom", a, static=False))
    tree.add_transform(edge("odom", "base", b, static=False))
    tree.add_transform(edge("base", "camera", c))
    found = tree.at("map", "camera", 0)
    np.testing.assert_allclose(found.transform, a @ b @ c, atol=1e-12)
    assert (found.frame_id, found.child_frame_id) == ("map", "camera")
    assert tree.root_of("camera") == "map"
    np.testing.assert_allclose(tree.at("odom", "camera", 0).transform, b @ c, atol=1e-12)


def test_covariance_agrees_with_sampled_errors(rng):
    first, second, mount = (transform(rng) for _ in range(3))
    roots = [1e-3 * rng.normal(size=(6, 6)) for _ in range(2)]
    tree = TransformTree()
    tree.add_pose(PoseRecord(0, "map", first, roots[0] @ roots[0].T), "odom")
    tree.add_pose(PoseRecord(0, "odom", second, roots[1] @ roots[1].T), "base")
    tree.add_transform(edge("base", "camera", mount))
    found = tree.at("map", "camera", 0)
    errors = []
    for _ in range(20000):
        noisy = [
            perturb_transform(matrix, root @ rng.normal(size=6))
            for matrix, root in zip((first, second), roots, strict=True)
        ]
        sample = noisy[0] @ noisy[1] @ mount
        turn = Rotation.from_matrix(sample[:3, :3] @ found.transform[:3, :3].T).as_rotvec()
        errors.append([*(sample[:3, 3] - found.transform[:3, 3]), *turn])
    sampled = np.cov(np.array(errors).T)
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    np.testing.assert_allclose(found.covariance / scale, sampled / scale, atol=0.05)


def test_fixed_edges_are_exact():
    tree = TransformTree()
    tree.add_transform(edge("base", "camera", np.eye(4)))
    assert not tree.at("base", "camera", 5).covariance.any()


def test_moving_edge_without_covariance_makes_the_chain_unknown():
    tree = TransformTree()
    tree.add_pose(PoseRecord(0, "map", np.eye(4), np.eye(6)), "odom")
    tree.add_transform(edge("odom", "base", np.eye(4), static=False))
    assert tree.at("map", "base", 0).covariance is None


def test_edge_that_is_not_known_yet_can_arrive():
    tree = TransformTree()
    tree.add_transform(edge("map", "base", np.eye(4), stamp=SECOND, static=False))
    with pytest.raises(PoseUnavailableError) as caught:
        tree.at("map", "base", 2 * SECOND)
    assert caught.value.may_arrive


def test_frame_that_nobody_has_mentioned_can_arrive():
    with pytest.raises(PoseUnavailableError, match="camera") as caught:
        TransformTree().at("map", "camera", 0)
    assert caught.value.may_arrive


def test_frame_that_is_not_above_is_an_error():
    tree = TransformTree()
    tree.add_transform(edge("base", "camera", np.eye(4)))
    with pytest.raises(FrameError, match="'map' is not above 'camera'"):
        tree.at("map", "camera", 0)


def test_circle_is_an_error():
    tree = TransformTree()
    tree.add_transform(edge("a", "b", np.eye(4)))
    tree.add_transform(edge("b", "a", np.eye(4)))
    with pytest.raises(FrameError, match="circle"):
        tree.root_of("a")


def test_pose_takes_the_place_of_a_fixed_edge(rng):
    pose = transform(rng)
    tree = TransformTree()
    tree.add_transform(edge("base", "camera", np.eye(4)))
    tree.add_pose(PoseRecord(0, "map", pose), "camera")
    np.testing.assert_array_equal(tree.at("map", "camera", 0).transform, pose)
