"""What the localizer is told of the robot's motion, whoever follows the camera by it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import SensorFaultError
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.localization.filter.motion_prior import KinematicMotion, MotionPrior, RobotPosture
from infomap_ros.localization.localized_camera import LocalizedCamera, State
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.pipeline.camera_localizer import (
    TARGET_ORIGIN,
    CameraLocalizer,
    CameraLocalizerConfig,
    origin_of,
)

MOTION = KinematicMotion()
CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)


class View:
    """All that the localizer reads of a view."""

    def __init__(self, stamp: int) -> None:
        self.stamp, self.camera = stamp, CAMERA
        self.image = np.full((48, 64), stamp % 256, np.uint8)


class ScriptedLocalizer:
    """Ends each view in a state that is given, and notes how it was told to have moved."""

    def __init__(self, states: list[State]) -> None:
        self.states, self.priors = states, list[MotionPrior | None]()

    def locate(self, view: Any, prior: MotionPrior | None, *_: Any, **__: Any) -> LocalizedCamera:
        self.priors.append(prior)
        return LocalizedCamera(view.stamp, self.states[len(self.priors) - 1], None, None)


def posture(x: float) -> RobotPosture:
    return RobotPosture(make_transform(np.eye(3), [x, 0.0, 0.0]), np.eye(4))


def priors_of(monkeypatch: pytest.MonkeyPatch, states: list[State]) -> list[MotionPrior | None]:
    """Of a robot that goes straight on by 0.1 m from view to view."""
    scripted = ScriptedLocalizer(states)
    localizer = CameraLocalizer(CameraLocalizerConfig(LocalizerConfig(), MOTION, None, 0.0))
    monkeypatch.setattr(localizer, "_make", lambda *_: scripted)
    for number in range(len(states)):
        localizer.locate(View(number), posture(0.1 * number))  # type: ignore[arg-type]
    return scripted.priors


def test_the_kinematics_err_at_the_two_ends_of_a_way_that_no_view_tells(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    states: list[State] = ["tracking", "coasting", "lost", "coasting", "tracking"]

    first, *priors = priors_of(monkeypatch, states)

    assert first is None
    motion = MotionPrior(np.eye(4), np.zeros((6, 6)))
    for prior in priors:
        assert prior is not None
        motion = motion.then(prior)
    whole = MOTION.between(posture(0.0), posture(0.4))
    np.testing.assert_allclose(motion.T_before_after, whole.T_before_after, atol=1e-12)
    sigmas = [np.sqrt(np.diag(each.covariance)[3:]) for each in (motion, whole)]
    np.testing.assert_allclose(*sigmas, rtol=0.01)


def test_between_views_that_tell_the_pose_the_kinematics_err_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, *priors = priors_of(monkeypatch, ["tracking"] * 4)

    expected = MOTION.between(posture(0.0), posture(0.1)).covariance
    for prior in priors:
        assert prior is not None
        np.testing.assert_allclose(prior.covariance, expected, rtol=1e-9, atol=1e-15)


def test_images_that_stand_still_while_odometry_moves_are_not_located(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scripted = ScriptedLocalizer(["tracking"] * 9)
    localizer = CameraLocalizer(CameraLocalizerConfig(LocalizerConfig(), MOTION, None, 0.0))
    monkeypatch.setattr(localizer, "_make", lambda *_: scripted)
    frozen = View(0).image

    def locate(number: int, x: float, image: np.ndarray) -> None:
        view = View(number)
        view.image = image
        localizer.locate(view, posture(x))  # type: ignore[arg-type]

    locate(0, 0.0, frozen)
    locate(1, 0.02, frozen)  # within what odometry drifts
    for number in (2, 3):
        with pytest.raises(SensorFaultError, match="frozen while odometry moves"):
            locate(number, 0.02 * number, frozen)
    locate(4, 0.08, View(4).image)
    motion = scripted.priors[-1]
    assert motion is not None  # since the last view that was located
    np.testing.assert_allclose(motion.T_before_after[0, 3], 0.06)


def test_an_origin_is_named_by_the_view_with_which_a_map_begins() -> None:
    first, again, later = View(10**9), View(10**9), View(10**9 + 1)
    assert origin_of(first) == origin_of(again)  # type: ignore[arg-type]
    assert origin_of(first) != origin_of(later)  # type: ignore[arg-type]
    assert TARGET_ORIGIN < origin_of(first) < 2**32  # type: ignore[arg-type]
