"""Sightings of a teammate tell where its map is, and when the two maps are the same."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import invert_transform, perturb_transform
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig
from infomap_ros.localization.target.tag_detector import TagTargetConfig, TagTargetDetector
from infomap_ros.localization.target.target import TargetSighting
from infomap_ros.localization.target.team_alignment import (
    Alignment,
    TeamAlignment,
    TeamTagsConfig,
    fuse_alignments,
)

from .tag_scenes import BoardView, pose_error, seen_from

SIGMAS = np.array([0.02, 0.03, 0.02, 0.01, 0.02, 0.01])
COVARIANCE = np.diag(SIGMAS**2)
ELSEWHERE = perturb_transform(np.eye(4), [2.0, -1.0, 0.0, 0.0, 0.0, 1.0])


def sighting(truth: np.ndarray, rng: np.random.Generator) -> Alignment:
    return Alignment(perturb_transform(truth, rng.normal(0.0, SIGMAS)), COVARIANCE)


def test_maps_that_are_the_same_are_left_alone(rng: np.random.Generator) -> None:
    told = TeamAlignment(sightings=3)
    assert [told.add(sighting(np.eye(4), rng)) for _ in range(300)] == [None] * 300


def test_maps_that_are_not_are_aligned_as_well_as_it_says(rng: np.random.Generator) -> None:
    values = []
    for _ in range(60):
        told = TeamAlignment(sightings=4)
        for _ in range(3):
            assert told.add(sighting(ELSEWHERE, rng)) is None
        found = told.add(sighting(ELSEWHERE, rng))
        assert found is not None
        error = pose_error(found.T_a_b, ELSEWHERE)
        values.append(error @ np.linalg.solve(found.covariance, error))
    assert np.mean(values) < 6.0  # independent sightings, taken for ones that share errors


def test_a_wrong_sighting_among_others_does_no_harm(rng: np.random.Generator) -> None:
    told = TeamAlignment(sightings=4)
    told.add(sighting(invert_transform(ELSEWHERE), rng))
    for _ in range(2):
        told.add(sighting(ELSEWHERE, rng))
    found = told.add(sighting(ELSEWHERE, rng))
    assert found is not None
    assert np.linalg.norm(pose_error(found.T_a_b, ELSEWHERE)[:3]) < 0.1


def test_sightings_that_contradict_each_other_move_nothing(rng: np.random.Generator) -> None:
    told = TeamAlignment(sightings=4)
    for pose in (ELSEWHERE, np.eye(4), ELSEWHERE, np.eye(4)):
        assert told.add(sighting(pose, rng)) is None
    assert told.problem == "sightings contradict each other"


def test_the_lists_of_tags_have_to_fit() -> None:
    pose = (0.1, 0.0, 0.2, 0.0, 0.0, 0.0)
    config = TeamTagsConfig(robots=(2, 1, 2), ids=(7, 8, 9), poses=(*pose, *pose, *pose))
    assert {one.robot: one.tags.board.ids for one in config.carried()} == {"1": (8,), "2": (7, 9)}
    assert [one.robot for one in config.carried(but=2)] == ["1"]
    with pytest.raises(ConfigError, match="ids"):
        TeamTagsConfig(robots=(2,), ids=())
    with pytest.raises(ConfigError, match="poses"):
        TeamTagsConfig(robots=(2,), ids=(1,), poses=pose[:5])
    with pytest.raises(ConfigError, match="family"):
        TeamTagsConfig(robots=(2,), ids=(1,), poses=pose, family="tag99")


def test_robots_that_see_the_same_target_have_one_map(rng: np.random.Generator) -> None:
    """Two cameras see one board; what lies between them is as it truly is, within the errors."""
    board = TagBoard(TagBoardConfig())
    detector, values = TagTargetDetector(TagTargetConfig()), []
    for _ in range(4):
        truths = [seen_from(board, distance, 0.4, rng) for distance in (1.2, 1.8)]
        found = [detector.detect(BoardView(board, each, rng, 0.004)) for each in truths]
        first, second = found
        assert isinstance(first, TargetSighting) and isinstance(second, TargetSighting)
        between = Alignment(first.T_camera_target, first.covariance).then(
            Alignment(second.T_camera_target, second.covariance).inverse()
        )
        error = pose_error(between.T_a_b, truths[0] @ invert_transform(truths[1]))
        assert np.linalg.norm(error[:3]) < 0.03
        values.append(error @ np.linalg.solve(between.covariance, error))
    assert np.mean(values) < 16.0


def test_a_sighting_without_error_in_some_direction_is_left_out(rng: np.random.Generator) -> None:
    told = TeamAlignment(sightings=2)
    exact = Alignment(ELSEWHERE, np.diag([1e-4, 0.0, 1e-4, 1e-4, 1e-4, 1e-4]))
    assert told.add(exact) is None
    assert told.problem == "a sighting without an error in some direction"
    assert told.add(sighting(ELSEWHERE, rng)) is None
    assert told.problem == ""
    assert told.add(sighting(ELSEWHERE, rng)) is not None
    with pytest.raises(InvalidInputError, match="singular"):
        fuse_alignments([exact, exact])
