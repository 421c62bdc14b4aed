"""The pose of a board of tags: against rendered truth, and what must be refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from infomap_ros.geometry import (
    invert_transform,
    make_transform,
    perturb_transform,
    transform_points,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target import tag_detection
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig
from infomap_ros.localization.target.tag_detection import (
    TagFinder,
    Tags,
    refine_corners,
)
from infomap_ros.localization.target.tag_detector import TagTargetConfig, TagTargetDetector
from infomap_ros.localization.target.tag_pose import (
    KnownPoints,
    fit_pose,
    initial_poses,
    no_ranges,
    pixel_jacobian,
)
from infomap_ros.localization.target.target import TargetRefusal, TargetSighting
from infomap_ros.stereo import RangeCloud

from .tag_scenes import CAMERA, BoardView, draw_view, pose_error, seen_from, single_tag

BOARD = TagBoard()


@pytest.fixture
def _perfect_print(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tag_detection, "_SIGMA_FLOOR", 0.03)


class Scattered:
    """Tags with corners that scatter as the configuration says, and no image."""

    stamp, camera, has_cloud, tags = 0, CAMERA, False, None
    image = np.zeros((480, 640), np.uint8)

    def __init__(self, board: TagBoard, pose: FloatArray, sigma: float, rng: np.random.Generator):
        self.true = CAMERA.project(transform_points(pose, board.corners))
        noisy = self.true + rng.normal(0.0, sigma, self.true.shape)
        covariances = np.broadcast_to(sigma**2 * np.eye(2), (len(board.ids), 4, 2, 2))
        self.tags = Tags(np.array(board.ids), noisy, covariances)

    def inverse_depths(self, pixels: ArrayLike) -> tuple[FloatArray, FloatArray]:
        nothing = np.full(len(np.asarray(pixels)), np.nan)
        return nothing, nothing

    def cloud(self) -> RangeCloud:
        raise AssertionError("tags need no dense cloud")


def nees(sighting: TargetSighting, truth: FloatArray) -> float:
    error = pose_error(sighting.T_camera_target, truth)
    return float(error @ np.linalg.solve(sighting.covariance, error))


@pytest.mark.usefixtures("_perfect_print")
@pytest.mark.parametrize(("distance", "tilt"), [(0.9, 0.2), (1.8, 0.9), (2.6, 0.5)])
def test_corners_are_measured_to_a_tenth_of_a_pixel(
    distance: float, tilt: float, rng: np.random.Generator
) -> None:
    pose = seen_from(BOARD, distance, tilt, rng)
    tags = TagFinder("tag36h11").find(draw_view(BOARD, pose, rng))
    assert sorted(tags.ids) == list(BOARD.ids)
    truth = CAMERA.project(transform_points(pose, BOARD.corners[tags.ids]))
    assert np.abs(tags.corners - truth).max() < 0.15
    whitened = np.einsum(
        "tci,tcij,tcj->tc",
        tags.corners - truth,
        np.linalg.inv(tags.covariances),
        tags.corners - truth,
    )
    assert whitened.mean() < 4.0  # of 2


def test_an_edge_without_contrast_is_no_edge(rng: np.random.Generator) -> None:
    pose = seen_from(BOARD, 1.0, 0.3, rng)
    image = draw_view(BOARD, pose, rng)
    corners = CAMERA.project(transform_points(pose, BOARD.corners[0]))
    assert refine_corners(image, corners, 8, 15.0) is not None
    flat = np.where(image > 90, 90, image).astype(np.uint8)
    assert refine_corners(flat, corners, 8, 150.0) is None
    assert refine_corners(255 - image, corners, 8, 15.0) is None


def test_the_derivative_of_pixels_is_that_of_finite_differences(rng: np.random.Generator) -> None:
    pose = seen_from(BOARD, 1.3, 0.6, rng)
    points = BOARD.corners.reshape(-1, 3)
    jacobian = pixel_jacobian(CAMERA, points, pose)
    for axis in range(6):
        step = 1e-6 * np.eye(6)[axis]
        ahead = CAMERA.project(transform_points(perturb_transform(pose, step), points))
        behind = CAMERA.project(transform_points(perturb_transform(pose, -step), points))
        np.testing.assert_allclose(jacobian[:, :, axis], (ahead - behind) / 2e-6, atol=1e-4)


def test_points_on_a_line_or_in_one_pixel_have_no_pose(rng: np.random.Generator) -> None:
    on_line = np.arange(8.0)[:, None] * [0.1, 0.0, 0.0]
    apart = rng.normal(size=(8, 3))
    pixels = 300.0 + 20.0 * rng.normal(size=(8, 2))
    assert len(initial_poses(on_line, pixels, CAMERA)) == 0
    assert len(initial_poses(apart, np.full((8, 2), 300.0), CAMERA)) == 0


def test_no_fit_begins_with_points_behind_the_camera() -> None:
    square = np.array([[-0.1, 0.1, 0.0], [0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, -0.1, 0.0]])
    known = KnownPoints(square, np.zeros((4, 2)), np.broadcast_to(np.eye(2), (4, 2, 2)))
    for z in (-1.0, 0.0):
        behind = make_transform(np.eye(3), [0.0, 0.0, z])
        assert fit_pose(CAMERA, known, no_ranges(), behind) is None


@pytest.mark.usefixtures("_perfect_print")
def test_rendered_boards_are_found_within_their_covariance(rng: np.random.Generator) -> None:
    detector, values = TagTargetDetector(), []
    for distance, tilt in ((0.8, 0.1), (1.5, 0.0), (1.5, 0.8), (2.4, 0.3), (2.4, 0.7)):
        pose = seen_from(BOARD, distance, tilt, rng)
        sighting = detector.detect(BoardView(BOARD, pose, rng))
        assert isinstance(sighting, TargetSighting)
        error = pose_error(sighting.T_camera_target, pose)
        assert np.linalg.norm(error[:3]) < 0.001 * distance
        assert np.linalg.norm(error[3:]) < np.radians(0.3)
        values.append(nees(sighting, pose))
    assert max(values) < 25.0


def test_the_covariance_is_honest(rng: np.random.Generator) -> None:
    """Mean normalized error squared over 150 boards within the 95 % band of its distribution."""
    detector, values = TagTargetDetector(), []
    for _ in range(150):
        pose = seen_from(BOARD, rng.uniform(0.8, 3.0), rng.uniform(0.0, 1.1), rng)
        view = Scattered(BOARD, pose, 0.25, rng)
        sighting = detector.locate(view.tags, view)
        assert isinstance(sighting, TargetSighting)
        values.append(nees(sighting, pose))
    # 6 degrees of freedom: 6 +- 1.96 sqrt(12 / 150); the residuals only ever widen it
    assert 4.5 < np.mean(values) < 6.6


def test_range_decides_between_the_two_poses_of_a_far_tag(rng: np.random.Generator) -> None:
    board = single_tag()
    detector = TagTargetDetector(TagTargetConfig(board=board.config))
    ambiguous, values = 0, []
    for _ in range(12):
        pose = seen_from(board, 2.4, 0.35, rng)
        image_only = Scattered(board, pose, 0.25, rng)
        refusal = detector.locate(image_only.tags, image_only)
        ambiguous += isinstance(refusal, TargetRefusal) and refusal.reason == "ambiguous"
        with_range = BoardView.__new__(BoardView)
        with_range.camera, with_range._plane = CAMERA, pose @ board.T_target_board
        with_range._rng, with_range._sigma = rng, 0.003
        sighting = detector.locate(image_only.tags, with_range)
        if isinstance(sighting, TargetSighting):
            values.append(nees(sighting, pose))
    assert ambiguous >= 9
    assert len(values) >= 9
    assert max(values) < 25.0


def test_a_wrong_pose_of_a_far_tag_is_never_told(rng: np.random.Generator) -> None:
    """Without range: found or refused, but no error beyond what the covariance says."""
    board = single_tag()
    detector, told = TagTargetDetector(TagTargetConfig(board=board.config)), 0
    for _ in range(150):
        pose = seen_from(board, rng.uniform(0.5, 4.0), rng.uniform(0.0, 1.2), rng)
        view = Scattered(board, pose, 0.25, rng)
        result = detector.locate(view.tags, view)
        if isinstance(result, TargetSighting):
            told += 1
            assert nees(result, pose) < 40.0
    assert told > 30


def test_a_board_printed_to_a_wrong_scale_is_refused(rng: np.random.Generator) -> None:
    pose = seen_from(BOARD, 1.2, 0.4, rng)
    view = BoardView(BOARD, pose, rng, range_sigma=0.003)
    larger = TagBoardConfig(side=0.176, gap=0.044, margin=0.044)
    refusal = TagTargetDetector(TagTargetConfig(board=larger)).detect(view)
    assert isinstance(refusal, TargetRefusal)
    assert refusal.reason == "range contradicts size"


def test_a_tag_that_has_come_off_is_left_out(rng: np.random.Generator) -> None:
    pose = seen_from(BOARD, 1.2, 0.4, rng)
    view = Scattered(BOARD, pose, 0.1, rng)
    view.tags.corners[2] += [7.0, -4.0]
    sighting = TagTargetDetector().locate(view.tags, view)
    assert isinstance(sighting, TargetSighting)
    assert sighting.score == pytest.approx(0.75)
    assert nees(sighting, pose) < 25.0


def test_tags_that_contradict_each_other_are_refused(rng: np.random.Generator) -> None:
    pose = seen_from(BOARD, 1.2, 0.4, rng)
    view = Scattered(BOARD, pose, 0.1, rng)
    view.tags.corners[0] += [30.0, 0.0]
    view.tags.corners[1] += [0.0, 30.0]
    view.tags.corners[2] -= [30.0, 30.0]
    refusal = TagTargetDetector().locate(view.tags, view)
    assert isinstance(refusal, TargetRefusal)
    assert refusal.reason == "inconsistent"


def test_tags_of_another_board_are_not_the_target(rng: np.random.Generator) -> None:
    view = BoardView(BOARD, seen_from(BOARD, 1.2, 0.4, rng), rng)
    other = TagTargetDetector(TagTargetConfig(board=TagBoardConfig(first_id=40)))
    refusal = other.detect(view)
    assert isinstance(refusal, TargetRefusal)
    assert refusal.reason == "not in view"


def test_a_sighting_tells_where_the_camera_is(rng: np.random.Generator) -> None:
    """Its covariance in the target's frame is that of simulated errors."""
    pose = seen_from(BOARD, 1.2, 0.4, rng)
    root = rng.normal(0.0, 0.003, (6, 6))
    sighting = TargetSighting(pose, root @ root.T, 1.0, "test")
    T_target_camera, covariance = sighting.camera_pose()
    errors = [
        pose_error(T_target_camera, invert_transform(perturb_transform(pose, root @ noise)))
        for noise in rng.standard_normal((4000, 6))
    ]
    sampled = np.cov(np.array(errors).T)
    np.testing.assert_allclose(covariance, sampled, atol=0.08 * np.abs(sampled).max())


def test_another_frame_on_the_target_has_its_own_covariance(rng: np.random.Generator) -> None:
    pose = seen_from(BOARD, 1.2, 0.4, rng)
    root = rng.normal(0.0, 0.003, (6, 6))
    shift = make_transform(np.eye(3), [0.5, -1.0, 2.0])
    moved = TargetSighting(pose, root @ root.T, 1.0, "test").of_frame(shift)
    errors = [
        pose_error(moved.T_camera_target, perturb_transform(pose, root @ noise) @ shift)
        for noise in rng.standard_normal((4000, 6))
    ]
    sampled = np.cov(np.array(errors).T)
    np.testing.assert_allclose(moved.covariance, sampled, atol=0.08 * np.abs(sampled).max())
