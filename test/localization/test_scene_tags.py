"""Tags of the scene are landmarks: begun where they are first seen, known again for certain."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, invert_transform, make_transform, transform_points
from infomap_ros.geometry.transforms import perturb_transform
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.localizer import Localizer
from infomap_ros.localization.localizer_config import CalibrationConfig, LocalizerConfig
from infomap_ros.localization.target import tag_detection
from infomap_ros.localization.target.config import TargetConfig, make_detector
from infomap_ros.localization.target.scene_tags import SceneTags, SceneTagsConfig
from infomap_ros.localization.target.tag_board import TagBoardConfig
from infomap_ros.localization.target.tag_detection import Tags
from infomap_ros.localization.target.tag_detector import TagTargetConfig, TagTargetDetector
from infomap_ros.localization.target.target import TargetRefusal

from .fiducial_scene import pose_error, squared_distance
from .room_views import CAMERA, STEP, dark, looking, view, with_tags

SIDE = 0.4
PLACES = {
    **{4: (1, -0.3, 0.2), 5: (1, 0.6, -0.1)},  # on the wall x = 2
    **{9: (3, 0.1, 0.0), 2: (0, 0.3, 0.1), 30: (2, 0.0, 0.2)},  # on y = 2, x = -2, y = -2
}
BEFORE = with_tags(SIDE, PLACES)
AFTER = [BEFORE[0], with_tags(SIDE, PLACES, first=3)[1], *BEFORE[2:]]
EXACT = CalibrationConfig(0.0, 0.0, 0.0)
TAGS = SceneTagsConfig("tag36h11", SIDE)
LOOP = [
    looking((0.3 * np.cos(a), 0.3 * np.sin(a), 0.05 * np.sin(2.0 * a)), a)
    for a in np.linspace(0.0, 2.0 * np.pi, 50)
]


def errors(tags: SceneTagsConfig, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the poses along the loop, shape (N, 6), and NEES / 6, shape (N,).

    Behind the camera's back the wall that it saw first is papered anew; its tags hang where they
    hung.
    """
    config = LocalizerConfig(40, 25, calibration=EXACT, scene_tags=tags)
    localizer = Localizer(CAMERA, config, T_map_camera=LOOP[0], covariance=1e-8 * np.eye(6))
    off, nees = [], []
    for i, pose in enumerate(LOOP):
        walls = BEFORE if i < 25 else AFTER
        found = localizer.locate(view((i + 1) * STEP, pose, 1000 * seed + i, walls))
        assert found.T_map_camera is not None and found.covariance is not None
        off.append(pose_error(pose, found.T_map_camera))
        nees.append(squared_distance(off[-1], found.covariance) / 6.0)
    return np.array(off), np.array(nees)


def test_tags_that_are_seen_again_take_out_the_drift_of_a_loop(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tag_detection, "_SIGMA_FLOOR", 0.1)  # a better print than is assumed
    with_tags_off, nees = errors(TAGS, seed=1)
    without_off, _ = errors(SceneTagsConfig(), seed=1)
    drift, less = (np.linalg.norm(off[-4:], axis=0) for off in (without_off, with_tags_off))
    assert np.linalg.norm(less[:3]) < 0.6 * np.linalg.norm(drift[:3])
    assert np.linalg.norm(less[3:]) < 0.6 * np.linalg.norm(drift[3:])
    assert 0.05 < np.mean(nees) < 2.0


def test_tags_of_the_target_are_landmarks_at_given_places():
    seen = view(STEP, LOOP[0], 0, BEFORE)
    found = SceneTags(TAGS).observe(seen).ids
    assert sorted(found) == [-24, -23, -22, -21, -20, -19, -18, -17]  # tags 4 and 5
    board = TagBoardConfig(side=SIDE, columns=1, rows=1, first_id=4)
    half = SIDE / 2.0
    for pose in ((), (1.0, 2.0, 3.0, 0.0, 0.0, np.pi / 2.0)):
        target = make_detector(TargetConfig("tags", pose, TagTargetConfig(board)))
        tags = SceneTags(TAGS, target.board)  # type: ignore[union-attr]
        assert sorted(tags.observe(seen).ids) == sorted(found)
        places = {int(ids[0]): rest for ids, *rest in tags.unknown(seen, np.zeros(0, np.int64))}
        corners, covariance, in_map = places[-17]
        assert in_map and not covariance.any() and not places[-21][2] and places[-21][1].any()
        first = (0.0, -half, half) if not pose else (1.0 + half, 2.0, 3.0 + half)
        np.testing.assert_allclose(corners[0], first, atol=1e-9)
    other = make_detector(TargetConfig("tags", (), TagTargetConfig(TagBoardConfig("tag25h9"))))
    tags = SceneTags(TAGS, other.board)  # type: ignore[union-attr]
    assert not any(in_map for *_, in_map in tags.unknown(seen, np.zeros(0, np.int64)))


def test_a_tag_of_which_two_poses_explain_a_view_is_begun_where_both_may_be():
    half, rng = 0.08, np.random.default_rng(5)
    square = half * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    config = TagBoardConfig(side=2.0 * half, columns=1, rows=1, mounting="flat")
    detector, values, refused = TagTargetDetector(TagTargetConfig(config)), [], 0
    dim = dark(STEP)
    for _ in range(80):
        turn = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * Rotation.from_rotvec(
            [*rng.normal(0.0, 0.15, 2), 0.0]
        )
        pose = make_transform(turn.as_matrix(), [0.1, -0.1, 2.0])
        true = transform_points(pose, square)
        pixels = CAMERA.project(true) + rng.normal(0.0, 0.3, (4, 2))
        tags = Tags(np.zeros(1, np.int64), pixels[None], np.tile(0.09 * np.eye(2), (1, 4, 1, 1)))
        refused += isinstance(detector.locate(tags, dim), TargetRefusal)
        placed = detector.place(tags, dim)
        assert placed is not None
        blocks = placed[1].reshape(4, 3, 4, 3)[range(4), :, range(4)]
        off = placed[0] - true
        values.append(np.mean([squared_distance(*one) for one in zip(off, blocks, strict=True)]))
    assert refused > 40
    assert 0.6 < np.mean(values) / 3.0 < 1.5


POINTS = np.random.default_rng(1).uniform([1.0, -2.0, -1.0], [3.0, 2.0, 1.0], (12, 3))
"""In the map [m]: the camera looks along x."""
SMALL = FiducialFilterConfig(max_fiducials=20, max_kept_poses=2)
SQUARE = 0.2 * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])


def measured(
    T_map_camera: np.ndarray, points: np.ndarray, rng: np.random.Generator, has_range: bool
) -> FiducialObservations:
    """Points in the map, in the order of their ids -1, -2, and so on; with noise."""
    inside = transform_points(invert_transform(T_map_camera), points)
    pixels = CAMERA.project(inside) + rng.normal(0.0, 0.5, (len(points), 2))
    inverse = 1.0 / inside[:, 2] + rng.normal(0.0, 0.01, len(points))
    one = np.ones(len(points)) if has_range else np.full(len(points), np.nan)
    ids, sigmas = -1 - np.arange(len(points)), np.full(len(points), 0.5)
    return FiducialObservations(ids, pixels, sigmas, one * inverse, 0.01 * one)


def wandering(rng: np.random.Generator, start: np.ndarray, count: int) -> list[tuple]:
    """True poses with the motion that odometry told before each."""
    sigmas = np.array([0.01] * 3 + [0.01] * 3)
    told, pose = [], start
    for _ in range(count):
        step = perturb_transform(np.eye(4), rng.normal(0.0, 0.02, 6))
        error = sigmas * rng.standard_normal(6)
        pose = pose @ perturb_transform(step, error)
        told.append((pose, MotionPrior(step, np.diag(sigmas**2))))
    return told


def test_one_given_landmark_in_each_image_is_enough():
    """Consistent with and without errors of the places, and far better than odometry alone."""
    values, ends, alone = [], [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        start, spread = looking((0.0, 0.0, 0.0), 0.0), 0.02**2 * np.eye(6)
        surveyed = 0.02 * (seed % 2)
        given = POINTS + rng.normal(0.0, 1.0, POINTS.shape) * surveyed
        pose_filter = FiducialFilter(CAMERA, SMALL)
        pose_filter.start(perturb_transform(start, 0.02 * rng.standard_normal(6)), spread)
        covariance = surveyed**2 * np.eye(3 * len(given))
        pose_filter.add_landmarks(-1 - np.arange(len(given)), given, covariance, in_map=True)
        reckoned = pose_filter.pose[0]
        for pose, prior in wandering(rng, start, 30):
            pose_filter.predict(prior)
            reckoned = reckoned @ prior.T_before_after
            inside = CAMERA.project(transform_points(invert_transform(pose), POINTS))
            size = [CAMERA.width, CAMERA.height]
            visible = np.flatnonzero(((inside > 0.0) & (inside < size)).all(axis=1))
            if len(visible):
                seen = measured(pose, POINTS, rng, True).select(rng.choice(visible, 1))
                pose_filter.update(seen)
        found, known = pose_filter.pose
        error = pose_error(pose, found)
        values.append(squared_distance(error, known) / 6.0)
        ends.append(np.linalg.norm(error[:3]))
        alone.append(np.linalg.norm(pose_error(pose, reckoned)[:3]))
    assert 0.6 < np.mean(values) < 1.5
    assert np.median(ends) < 0.5 * np.median(alone)


def test_a_tag_that_was_begun_by_its_size_tells_where_the_camera_is_as_well_as_it_says():
    values = []
    turn = make_transform(looking((0.0, 0.0, 0.0), 0.0)[:3, :3].T, np.array([0.1, -0.1, 1.5]))
    shared = np.diag(np.square([0.01, 0.01, 0.03, 0.02, 0.02, 0.01]))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        start = looking((0.5, -0.2, 0.1), 0.4)
        true = start @ turn
        pose_filter = FiducialFilter(CAMERA, SMALL)
        off = perturb_transform(np.eye(4), 0.01 * rng.standard_normal(6))
        pose_filter.start(off @ start, 0.011**2 * np.eye(6))
        # The tag as a detector tells it: its pose in the camera is off, and its shape is right.
        error = rng.multivariate_normal(np.zeros(6), shared)
        tag = perturb_transform(invert_transform(start) @ true, error)
        corners = transform_points(tag, SQUARE)
        lever = corners - tag[:3, 3]
        x, y, z, o = *lever.T, np.zeros(4)
        by_turn = np.stack([[o, z, -y], [-z, o, x], [y, -x, o]]).transpose(2, 0, 1)
        over = np.concatenate([np.tile(np.eye(3), (4, 1, 1)), by_turn], axis=2).reshape(12, 6)
        pose_filter.add_landmarks(-1 - np.arange(4), corners, over @ shared @ over.T)
        for pose, prior in wandering(rng, start, 12):
            pose_filter.predict(prior)
            pose_filter.update(measured(pose, transform_points(true, SQUARE), rng, False))
        found, known = pose_filter.pose
        values.append(squared_distance(pose_error(pose, found), known) / 6.0)
    assert 0.6 < np.mean(values) < 1.5


@pytest.mark.parametrize("in_map", [False, True])
def test_landmarks_are_not_forgotten_for_new_fiducials(in_map: bool):
    camera = PinholeCamera(640, 480, 400.0, 400.0, 320.0, 240.0)
    pose_filter = FiducialFilter(camera)
    pose_filter.add_landmarks([-1, -2], np.ones((2, 3)), 1e-4 * np.eye(6), in_map=in_map)
    for first in range(0, 600, 100):
        ids, ones = np.arange(first, first + 100), np.ones(100)
        pixels = np.random.default_rng(first).uniform(50.0, 400.0, (100, 2))
        pose_filter.add(FiducialObservations(ids, pixels, ones, ones, 0.01 * ones))
    held = pose_filter.fiducials().ids
    assert len(held) == 300 and {-1, -2} <= set(held.tolist())
