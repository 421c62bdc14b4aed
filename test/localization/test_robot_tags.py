"""Robots seen by their tags, and the alignment of two maps that follows from it."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import invert_transform, make_transform, perturb_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig
from infomap_ros.localization.target.tag_detector import TagTargetConfig
from infomap_ros.localization.target.team_alignment import (
    Alignment,
    RobotTagFinder,
    RobotTags,
    align_by_sighting,
    fuse_alignments,
    squared_distance,
    tag_pose,
)

from .tag_scenes import BoardView, pose_error, seen_from

PRINT = TagBoard(TagBoardConfig(columns=1, rows=1, side=0.12, first_id=5))


def rover(name: str, *ids: int, family: str = "tag36h11") -> RobotTags:
    """Tags of 0.12 m at the back of a robot, one above the other."""
    poses = [tag_pose((-0.3, 0.0, 0.2 + 0.2 * i), (-1.0, 0.0, 0.0)) for i in range(len(ids))]
    flat = tuple(float(number) for pose in poses for number in pose)
    board = TagBoardConfig(family=family, side=0.12, ids=ids, poses=flat)
    return RobotTags(name, TagTargetConfig(board=board))


def drawn(sigmas: FloatArray, pose: FloatArray, rng: np.random.Generator) -> FloatArray:
    return perturb_transform(pose, rng.normal(0.0, sigmas))


def some_pose(rng: np.random.Generator) -> FloatArray:
    return perturb_transform(np.eye(4), rng.normal(0.0, 1.0, 6))


def test_a_tag_on_the_back_faces_backwards() -> None:
    board = rover("red", 5).tags.board
    corners = TagBoard(board).corners[0]
    expected = [
        [-0.3, 0.06, 0.26],
        [-0.3, -0.06, 0.26],
        [-0.3, -0.06, 0.14],
        [-0.3, 0.06, 0.14],
    ]  # seen from behind, the robot's left is on the left
    np.testing.assert_allclose(corners, expected, atol=1e-12)


def test_a_robot_is_found_where_its_tag_is(rng: np.random.Generator) -> None:
    T_camera_print = seen_from(PRINT, 1.2, 0.5, rng)
    view = BoardView(PRINT, T_camera_print, rng, range_sigma=0.004)
    other = rover("red", 5)
    T_base_camera = make_transform(
        [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.2, 0.0, 0.5]
    )
    sightings, refused = RobotTagFinder([other, rover("blue", 9)]).find(view, T_base_camera)
    assert [one.robot for one in sightings] == ["red"]
    assert not refused
    # the tag as an upright board is the same print as on the robot
    tag_in_base = TagBoard(other.tags.board).tag_poses[0]
    tag_in_print = PRINT.tag_poses[0]
    truth = T_base_camera @ T_camera_print @ tag_in_print @ invert_transform(tag_in_base)
    error = pose_error(sightings[0].T_base_other, truth)
    assert np.linalg.norm(error[:3]) < 0.02
    assert error @ np.linalg.solve(sightings[0].covariance, error) < 22.0


def test_the_error_of_the_own_camera_is_added(rng: np.random.Generator) -> None:
    view = BoardView(PRINT, seen_from(PRINT, 1.0, 0.4, rng), rng, range_sigma=0.004)
    finder = RobotTagFinder([rover("red", 5)])
    mount = np.diag([1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4])
    exact = finder.find(view, np.eye(4))[0][0].covariance
    loose = finder.find(view, np.eye(4), mount)[0][0].covariance
    added = loose - exact
    # a rotation error of 0.01 rad about the camera moves the robot by 0.01 times its distance
    place = finder.find(view, np.eye(4))[0][0].T_base_other[:3, 3]
    expected = 2.0 * 1e-4 * place @ place + 3e-6
    assert np.trace(added[:3, :3]) == pytest.approx(expected, rel=0.02)


def test_a_team_without_tags_sees_nobody(rng: np.random.Generator) -> None:
    view = BoardView(PRINT, seen_from(PRINT, 1.0, 0.4, rng), rng)
    assert RobotTagFinder([]).find(view, np.eye(4)) == ([], {})


def test_tags_must_belong_to_one_robot() -> None:
    with pytest.raises(ConfigError, match="one robot only"):
        RobotTagFinder([rover("red", 5), rover("blue", 5)])
    with pytest.raises(ConfigError, match="different name"):
        RobotTagFinder([rover("red", 5), rover("red", 6)])
    with pytest.raises(ConfigError, match="family"):
        RobotTagFinder([rover("red", 5), rover("blue", 6, family="tag25h9")])
    with pytest.raises(ConfigError, match="poses"):
        RobotTags("red", TagTargetConfig(board=TagBoardConfig()))


def test_a_tag_without_an_upper_side_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="up"):
        tag_pose((0, 0, 0), (0, 0, 1))


@pytest.mark.parametrize("kind", ["target", "sighting"])
def test_alignments_are_as_good_as_they_say(kind: str, rng: np.random.Generator) -> None:
    """NEES over 400 draws of all errors, mean within the 95 % band about six."""
    sigmas = np.array([0.03, 0.02, 0.04, 0.02, 0.03, 0.01])
    covariance = np.diag(sigmas**2)
    first, second, third = (some_pose(rng) for _ in range(3))
    values = []
    for _ in range(400):
        parts = [Alignment(drawn(sigmas, pose, rng), covariance) for pose in (first, second, third)]
        if kind == "target":
            result = parts[0].then(parts[2].inverse())
            truth = first @ invert_transform(third)
        else:
            result = align_by_sighting(*parts)
            truth = first @ second @ invert_transform(third)
        error = pose_error(result.T_a_b, truth)
        values.append(error @ np.linalg.solve(result.covariance, error))
    assert abs(np.mean(values) - 6.0) < 1.96 * np.sqrt(12.0 / 400.0) + 0.1  # first order


def test_the_inverse_of_an_inverse_is_the_alignment(rng: np.random.Generator) -> None:
    root = rng.normal(0.0, 0.01, (6, 6))
    one = Alignment(some_pose(rng), root @ root.T)
    back = one.inverse().inverse()
    np.testing.assert_allclose(back.T_a_b, one.T_a_b, atol=1e-12)
    np.testing.assert_allclose(back.covariance, one.covariance, atol=1e-12)


def test_fusing_alignments_is_weighted_least_squares(rng: np.random.Generator) -> None:
    truth = some_pose(rng)
    sigmas = rng.uniform(0.005, 0.02, (5, 6))
    parts = [Alignment(drawn(s, truth, rng), np.diag(s**2)) for s in sigmas]
    fused = fuse_alignments(parts)
    assert fused.is_consistent
    assert fused.agreeing.all()
    weights = 1.0 / sigmas**2
    np.testing.assert_allclose(fused.alignment.covariance, np.diag(1.0 / weights.sum(axis=0)))
    errors = np.array([pose_error(fused.alignment.T_a_b, one.T_a_b) for one in parts])
    np.testing.assert_allclose((weights * errors).sum(axis=0), 0.0, atol=1e-6)


def test_an_alignment_that_contradicts_is_left_out(rng: np.random.Generator) -> None:
    truth, sigma = some_pose(rng), np.full(6, 0.01)
    parts = [Alignment(drawn(sigma, truth, rng), np.diag(sigma**2)) for _ in range(4)]
    wrong = perturb_transform(truth, np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0]))
    parts.insert(1, Alignment(wrong, np.diag(sigma**2)))
    fused = fuse_alignments(parts)
    np.testing.assert_array_equal(fused.agreeing, [True, False, True, True, True])
    assert fused.is_consistent
    assert squared_distance(parts[0], parts[1]) > 100.0


def test_two_alignments_that_contradict_are_not_consistent() -> None:
    one = Alignment(np.eye(4), 1e-4 * np.eye(6))
    other = Alignment(make_transform(np.eye(3), [1.0, 0.0, 0.0]), 1e-4 * np.eye(6))
    assert not fuse_alignments([one, other]).is_consistent


def test_alignments_without_any_error_have_no_distance() -> None:
    exact = Alignment(np.eye(4), np.zeros((6, 6)))
    with pytest.raises(InvalidInputError, match="singular"):
        squared_distance(exact, exact)
    with pytest.raises(InvalidInputError, match="empty"):
        fuse_alignments([])
