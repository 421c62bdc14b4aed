"""The localizer follows a camera, corrects itself where it has been, and says when it is lost."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    Box,
    PlacedSolid,
    Sphere,
    invert_transform,
    make_transform,
    points_inside,
)
from infomap_ros.geometry.transforms import perturb_transform
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.localization.localizer import Localizer
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.saved_localization import SavedLocalization
from infomap_ros.localization.target import watch
from infomap_ros.localization.target.target import TargetRefusal, TargetSighting

from . import room_views
from .fiducial_scene import pose_error, squared_distance
from .room_views import CAMERA, STEP, dark, looking, view

EXACT = np.diag([1e-3**2] * 3 + [1e-3**2] * 3)


def along(count: int, start: int = 0) -> list[np.ndarray]:
    """Poses of a camera that moves and turns, 3 cm and 1.7 deg a view."""
    steps = range(start, start + count)
    return [looking((-0.5 + 0.03 * i, 0.2, 0.1), 0.03 * i - 0.3, 0.05) for i in steps]


def follow(localizer: Localizer, poses: list[np.ndarray], first: int = 1) -> list[LocalizedCamera]:
    """Locate views of poses, from images alone."""
    return [
        localizer.locate(view((first + i) * STEP, pose, seed=first + i))
        for i, pose in enumerate(poses)
    ]


def move_blindly(localizer: Localizer, first: int, *, has_odometry: bool) -> None:
    """Back and forth through darkness, by odometry that is good, until the camera is lost."""
    for i in range(8):
        step = make_transform(np.eye(3), [0.004 * (-1) ** i, 0.0, 0.0])
        motion = MotionPrior(step, 1e-6 * np.eye(6)) if has_odometry else None
        result = localizer.locate(dark((first + i) * STEP), motion)
    assert result.state == "lost"


def check(result: LocalizedCamera, true: np.ndarray, position: float = 0.01) -> None:
    """The pose is near the truth, and as near as it says (99.99 %)."""
    assert result.T_map_camera is not None and result.covariance is not None
    error = pose_error(true, result.T_map_camera)
    assert np.linalg.norm(error[:3]) < position
    assert squared_distance(error, result.covariance + 0.01 * EXACT) < 27.9


def test_follows_a_camera_by_its_images_alone():
    poses = along(25)
    localizer = Localizer(CAMERA, T_map_camera=poses[0])
    results = follow(localizer, poses)
    assert {result.state for result in results} == {"tracking"}
    for result, pose in zip(results, poses, strict=True):
        check(result, pose)
    assert results[0].reason == "initialized"
    assert min(result.tracked for result in results[1:]) >= 20


def test_keyframes_are_kept_where_the_camera_has_moved():
    poses = along(20)
    localizer = Localizer(CAMERA, T_map_camera=poses[0])
    results = follow(localizer, poses)
    told = [result.stamp for result in results if result.is_keyframe]
    kept = localizer.keyframes()
    assert kept.stamps.tolist() == told and told[0] == STEP and len(told) > 3
    for stamp, transform in zip(kept.stamps, kept.transforms, strict=True):
        error = pose_error(poses[stamp // STEP - 1], transform)
        assert np.linalg.norm(error[:3]) < 0.01


def test_a_camera_that_stands_still_does_not_become_ever_more_certain():
    moved = along(8)
    localizer = Localizer(CAMERA, T_map_camera=moved[0])
    follow(localizer, moved)
    still = follow(localizer, [moved[-1]] * 12, first=20)
    first, last = still[1].covariance, still[-1].covariance
    assert first is not None and last is not None
    assert np.trace(last) > 0.8 * np.trace(first)


def test_coming_back_takes_out_the_drift():
    there = along(18)
    localizer = Localizer(CAMERA, T_map_camera=there[0])
    away = follow(localizer, there)
    back = follow(localizer, there[::-1][1:], first=25)
    farthest, home = away[-1].covariance, back[-1].covariance
    assert farthest is not None and home is not None
    assert np.trace(home[:3, :3]) < 0.85 * np.trace(farthest[:3, :3])
    check(back[-1], there[0])


def test_a_camera_that_was_covered_and_carried_is_found_again_where_it_is_known():
    poses = along(20)
    localizer = Localizer(CAMERA, T_map_camera=poses[0])
    follow(localizer, poses)
    blind = [localizer.locate(dark((21 + i) * STEP)) for i in range(10)]
    assert blind[-1].state == "lost" and blind[-1].T_map_camera is None and blind[-1].reason
    results = follow(localizer, poses[8:12], first=40)
    found = [result for result in results if result.state == "tracking"]
    assert found
    for result, pose in zip(results, poses[8:12], strict=True):
        if result.T_map_camera is not None:
            check(result, pose, 0.02)


@pytest.mark.parametrize(
    ("has_odometry", "share", "is_found"),
    [(False, 0.35, True), (True, 0.35, False), (True, 1, True)],
)
def test_where_odometry_says_it_cannot_be_a_camera_is_found_by_many_fiducials_alone(
    has_odometry: bool, share: float, is_found: bool
):
    poses, rest = along(20), MotionPrior(np.eye(4), 1e-6 * np.eye(6))
    prior = rest if has_odometry else None
    localizer = Localizer(CAMERA, LocalizerConfig(max_coasting=0.5), T_map_camera=poses[0])
    follow(localizer, poses)
    move_blindly(localizer, 21, has_odometry=has_odometry)
    seen = view(40 * STEP, poses[8])
    seen.image[:, int(share * CAMERA.width) :] = 0
    result = localizer.locate(seen, prior)
    assert result.state == ("tracking" if is_found else "lost")
    if is_found:
        check(result, poses[8], 0.02)


def test_a_robot_that_stands_may_look_at_the_sky_for_as_long_as_it_likes():
    poses, rest = along(8), MotionPrior(np.eye(4), 1e-10 * np.eye(6))
    localizer = Localizer(CAMERA, LocalizerConfig(max_coasting=0.5), T_map_camera=poses[0])
    follow(localizer, poses)
    states = {localizer.locate(dark((9 + i) * STEP), rest).state for i in range(30)}
    assert states == {"coasting"}
    result = localizer.locate(view(40 * STEP, poses[-1]), rest)
    assert result.state == "tracking"
    check(result, poses[-1])


def test_a_camera_that_was_carried_to_an_unknown_place_stays_lost():
    poses = along(8)
    localizer = Localizer(CAMERA, T_map_camera=poses[0])
    follow(localizer, poses)
    for i in range(10):
        localizer.locate(dark((9 + i) * STEP))
    elsewhere = [looking((0.5, -0.5, 0.0), np.pi + 0.03 * i) for i in range(5)]
    assert {result.state for result in follow(localizer, elsewhere, first=30)} == {"lost"}


def test_odometry_carries_the_pose_through_darkness():
    poses = along(20)
    localizer = Localizer(CAMERA, T_map_camera=poses[0])
    follow(localizer, poses[:8])
    rng = np.random.default_rng(5)
    noise = np.diag([0.003**2] * 3 + [0.003**2] * 3)
    for i in range(8, 20):
        motion = invert_transform(poses[i - 1]) @ poses[i]
        prior = MotionPrior(perturb_transform(motion, rng.normal(0.0, 0.003, 6)), noise)
        seen = dark((i + 1) * STEP) if i < 14 else view((i + 1) * STEP, poses[i], seed=i)
        result = localizer.locate(seen, prior)
        assert result.state == ("coasting" if i < 14 else "tracking")
        check(result, poses[i], 0.05)


@pytest.mark.parametrize("has_gyroscope", [True, False])
def test_by_a_gyroscope_a_camera_that_turned_in_darkness_knows_where_it_looks(
    has_gyroscope: bool,
) -> None:
    turned = [0.3 * min(max(i - 7, 0), 4) for i in range(16)]  # to where it has never looked
    poses = [looking((-0.5 + 0.01 * i, 0.2, 0.1), turned[i] - 0.3, 0.05) for i in range(16)]
    localizer, rng = Localizer(CAMERA, T_map_camera=poses[0]), np.random.default_rng(6)
    for i, pose in enumerate(poses):
        motion = perturb_transform(invert_transform(poses[i - 1]) @ pose, rng.normal(0, 1e-3, 6))
        turn = motion[:3, :3] if i and has_gyroscope else None
        seen = dark((i + 1) * STEP) if 8 <= i < 11 else view((i + 1) * STEP, pose, seed=i)
        result = localizer.locate(seen, turn=turn)
    assert result.state == ("tracking" if has_gyroscope else "lost")
    if has_gyroscope:
        check(result, poses[-1], 0.05)


def test_odometry_that_does_not_know_of_being_carried_is_not_believed_for_long():
    poses = along(12)
    localizer = Localizer(CAMERA, T_map_camera=poses[0])
    follow(localizer, poses)
    rest = MotionPrior(np.eye(4), np.diag([0.002**2] * 3 + [0.002**2] * 3))
    localizer.locate(dark(20 * STEP), rest)
    # what is seen there is farther away (1) or nearer (2), as if something hid the rest
    for place, count in (((0.4, 0.2, 0.1), 4), ((-0.15, 0.2, 0.1), 12)):
        again = Localizer(CAMERA)
        again.resume(localizer.state())
        elsewhere = looking(place, np.pi, 0.05)
        states = [
            again.locate(view((21 + i) * STEP, elsewhere, seed=i), rest).state for i in range(count)
        ]
        assert "tracking" not in states and states[-1] == "lost"


def test_a_camera_that_comes_back_upside_down_is_not_taken_to_be_elsewhere():
    poses = along(12)
    localizer = Localizer(CAMERA, T_map_camera=poses[0])
    follow(localizer, poses)
    over = make_transform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    noise = np.diag([0.002**2] * 3 + [0.002**2] * 3)
    for i in range(5):
        motion = MotionPrior(np.eye(4) if i else over, noise)
        result = localizer.locate(view((13 + i) * STEP, poses[-1] @ over, seed=13 + i), motion)
        assert result.state != "lost"
    assert result.state == "tracking"
    check(result, poses[-1] @ over, 0.02)


def test_before_a_wall_that_repeats_itself_a_lost_camera_is_found_where_odometry_says(
    monkeypatch: pytest.MonkeyPatch,
):
    pieces = [np.tile(texture[:40, :40], (16, 16)) for texture in room_views._TEXTURES]
    monkeypatch.setattr(room_views, "_TEXTURES", pieces)
    poses, rest = along(12), MotionPrior(np.eye(4), 1e-6 * np.eye(6))
    localizer = Localizer(CAMERA, LocalizerConfig(max_coasting=0.5), T_map_camera=poses[0])
    follow(localizer, poses)
    move_blindly(localizer, 13, has_odometry=True)
    result = localizer.locate(view(30 * STEP, poses[-1], seed=30), rest)
    assert result.state == "tracking"
    check(result, poses[-1], 0.02)


def test_nothing_on_the_robots_body_is_chosen():
    pose = along(1)[0]
    wall = PlacedSolid(Box(np.array([20.0, 20.0, 20.0])), np.eye(4), "everything")
    localizer = Localizer(CAMERA, T_map_camera=pose)
    localizer.locate(view(STEP, pose), body=[wall])
    assert len(localizer.fiducials()) == 0
    free = Localizer(CAMERA, T_map_camera=pose)
    behind = make_transform(np.eye(3), [0.0, 0.0, -15.0])
    free.locate(view(STEP, pose), body=[PlacedSolid(wall.solid, behind, "behind")])
    assert len(free.fiducials()) > 20


def test_nothing_on_a_teammate_is_chosen():
    """Its body is placed in the map: what it hides is not to be mapped with it."""
    pose = along(1)[0]
    free = Localizer(CAMERA, T_map_camera=pose)
    free.locate(view(STEP, pose))
    places = free.fiducials().positions
    body = PlacedSolid(Sphere(0.8), make_transform(np.eye(3), np.median(places, axis=0)), "mate")
    is_near = points_inside(places, [body], 0.1)
    assert 3 < is_near.sum() < len(places) - 10
    localizer = Localizer(CAMERA, T_map_camera=pose)
    localizer.locate(view(STEP, pose), others=[body])
    chosen = localizer.fiducials().positions
    assert not points_inside(chosen, [body]).any()
    assert len(chosen) > (~is_near).sum() - 3


def test_a_saved_state_goes_on_with_a_prior_and_is_lost_without():
    poses = along(16)
    first = Localizer(CAMERA, T_map_camera=poses[0])
    follow(first, poses[:10])
    state = first.state()
    second = Localizer(CAMERA)
    second.resume(state)
    motion = invert_transform(poses[9]) @ poses[10]
    result = second.locate(view(11 * STEP, poses[10], seed=11), MotionPrior(motion, EXACT))
    assert result.state == "tracking"
    check(result, poses[10])
    third = Localizer(CAMERA)
    third.resume(state)
    unknown = looking((0.5, -0.5, 0.0), np.pi)
    assert third.locate(view(11 * STEP, unknown)).state == "lost"
    again = follow(third, poses[5:9], first=12)
    assert again[-1].state == "tracking"
    check(again[-1], poses[8], 0.02)


def test_knowledge_without_a_pose_finds_the_camera_wherever_odometry_puts_it():
    poses = along(16)
    first = Localizer(CAMERA, T_map_camera=poses[0])
    follow(first, poses)
    unplaced = SavedLocalization(first.state(), None).without_pose()
    second = Localizer(CAMERA)
    second.resume(unplaced.state)
    rest = MotionPrior(np.eye(4), np.diag([0.002**2] * 3 + [0.002**2] * 3))
    results = [second.locate(view((20 + i) * STEP, poses[2], seed=40 + i), rest) for i in range(4)]
    assert results[-1].state == "tracking"
    check(results[-1], poses[2], 0.02)


class SeenTarget:
    """Tells where the camera is, with an offset, as far as it is told to."""

    def __init__(self, true: dict[int, np.ndarray]) -> None:
        self.true = true

    def detect(self, seen: object) -> TargetSighting | TargetRefusal:
        stamp = seen.stamp  # type: ignore[attr-defined]
        if stamp not in self.true:
            return TargetRefusal("not in view")
        return TargetSighting(invert_transform(self.true[stamp]), EXACT, 1.0, "test")


def test_the_target_defines_the_map_and_nothing_is_known_before():
    poses = along(6)
    target = SeenTarget({3 * STEP: poses[2]})
    results = follow(Localizer(CAMERA, detector=target), poses)
    assert [result.state for result in results[:2]] == ["searching", "searching"]
    assert results[0].T_map_camera is None and "not in view" in results[0].reason
    assert results[2].target_seen
    for result, pose in zip(results[2:], poses[2:], strict=True):
        check(result, pose, 0.02)


def test_a_target_that_contradicts_again_and_again_is_believed(monkeypatch: pytest.MonkeyPatch):
    poses = along(12)
    moved = make_transform(np.eye(3), [0.5, 0.0, 0.0])
    true = {STEP: poses[0]} | {(i + 1) * STEP: moved @ poses[i] for i in range(4, 12)}
    monkeypatch.setattr(watch, "_INTERVAL", 0.0)
    monkeypatch.setattr(watch, "_KEYFRAME_DISTANCE", 0.01)
    results = follow(Localizer(CAMERA, detector=SeenTarget(true)), poses)
    check(results[3], poses[3], 0.02)
    check(results[-1], moved @ poses[-1], 0.02)
    assert any("cannot be" in result.reason for result in results)


def test_views_must_come_in_order():
    pose = along(1)[0]
    localizer = Localizer(CAMERA)
    localizer.locate(view(2 * STEP, pose))
    with pytest.raises(InvalidInputError, match="not later"):
        localizer.locate(view(2 * STEP, pose))
