"""An inertial sensor on the camera: how it turned between two views, and what is up."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import TransformRecord, make_transform
from infomap_ros.geometry.records import ImuRecord
from infomap_ros.pipeline.camera_localizer import level_by
from infomap_ros.pipeline.inertial import InertialSensor

MS = 1_000_000  # [ns]
MOUNTED = Rotation.from_euler("xyz", [1.2, -0.4, 2.0]).as_matrix()  # R_imu_camera
EDGE = TransformRecord(0, "imu", "camera", make_transform(MOUNTED, [0.1, 0.0, 0.02]), True)


def attitude(stamp: int) -> np.ndarray:
    """R_world_imu of a sensor that is tilted and turns about changing axes."""
    t = 1e-9 * stamp
    return Rotation.from_euler("zyx", [1.3 * t, 0.4 * np.sin(3.0 * t), 0.3 + 0.5 * t]).as_matrix()


def sample(stamp: int, frame: str = "imu") -> ImuRecord:
    """What it measures: the rate by a difference of a microsecond, and gravity."""
    step = attitude(stamp - 500).T @ attitude(stamp + 500)
    rate = Rotation.from_matrix(step).as_rotvec() / 1e-6
    return ImuRecord(stamp, frame, rate, attitude(stamp).T @ [0.0, 0.0, 9.81])


def sensor(stamps: range) -> InertialSensor:
    """One that has heard samples, and where the camera is on it."""
    known = InertialSensor("camera", [EDGE])
    for stamp in stamps:
        known.add(sample(stamp))
    return known


def turn_error(known: InertialSensor, first: int, second: int) -> float:
    """Angle by which the turn between two times is wrong [rad]."""
    before, after = known.at(first), known.at(second)
    assert before is not None and after is not None
    turn = after.turn_since(before)
    assert turn is not None
    true = (attitude(first) @ MOUNTED).T @ attitude(second) @ MOUNTED
    return float(Rotation.from_matrix(true.T @ turn).magnitude())


@pytest.mark.parametrize(("first", "second"), [(100, 200), (103, 507), (0, 995)])
def test_the_turn_between_two_views_is_that_of_the_camera(first: int, second: int) -> None:
    known = sensor(range(0, 1001 * MS, 5 * MS))
    assert turn_error(known, first * MS, second * MS) < 2e-4


def test_up_is_known_however_the_camera_is_mounted() -> None:
    reading = sensor(range(0, 1001 * MS, 5 * MS)).at(902 * MS)
    assert reading is not None and reading.up is not None
    true = (attitude(902 * MS) @ MOUNTED).T @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(reading.up, true, atol=2e-3)
    level = level_by(reading.up)
    np.testing.assert_allclose(level[:3, :3] @ reading.up, [0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(level[:3, :3] @ level[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(level[:3, :3]) > 0.0
    assert level[0, 2] > 0.0 and abs(level[1, 2]) < 1e-9  # the optical axis is above x


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, 0.01, -0.99995)])
def test_a_camera_that_looks_straight_up_or_down_has_a_level_map_too(up: tuple[float, ...]) -> None:
    level = level_by(np.array(up) / np.linalg.norm(up))
    np.testing.assert_allclose(level[2, :3], up, atol=1e-4)
    lower_edge = np.sign(up[2])  # of the image, which is the one ahead where it looks up
    np.testing.assert_allclose(level[:3, :3] @ [0.0, lower_edge, 0.0], [1.0, 0.0, 0.0], atol=0.011)


def test_shocks_are_no_gravity() -> None:
    known = sensor(range(0, 500 * MS, 5 * MS))
    for stamp in range(500 * MS, 600 * MS, 5 * MS):
        known.add(ImuRecord(stamp, "imu", sample(stamp).angular_velocity, np.array([60.0, 0, 0])))
    reading = known.at(550 * MS)
    assert reading is not None and reading.up is not None
    true = (attitude(550 * MS) @ MOUNTED).T @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(reading.up, true, atol=2e-3)


def test_the_next_sample_is_waited_for_but_not_a_sensor_that_fell_silent() -> None:
    known = sensor(range(0, 100 * MS, 5 * MS))
    with pytest.raises(PoseUnavailableError) as waits:
        known.at(97 * MS)
    assert waits.value.may_arrive
    assert known.at(97 * MS + 600 * MS) is None
    assert known.at(-1) is None
    assert InertialSensor("camera", [EDGE]).at(0) is None


def test_without_its_place_on_the_camera_a_sensor_does_not_count() -> None:
    known = InertialSensor("camera")
    known.add(sample(0))
    known.add(sample(5 * MS))
    assert known.at(5 * MS) is None
    known.add(EDGE)
    assert known.at(5 * MS) is not None
    assert known.is_mounted("imu") and known.is_mounted("camera") and not known.is_mounted("other")


@pytest.mark.parametrize(
    "odd",
    [
        pytest.param(lambda stamp: sample(stamp - 3 * MS), id="late"),
        pytest.param(lambda stamp: sample(stamp), id="twice"),
        pytest.param(lambda stamp: sample(stamp + 3_600_000 * MS), id="an hour ahead"),
        pytest.param(lambda stamp: sample(stamp - 3_600_000 * MS), id="an hour back"),
        pytest.param(lambda stamp: sample(stamp, "other"), id="another sensor"),
        pytest.param(
            lambda stamp: ImuRecord(stamp + 2 * MS, "imu", np.array([1e308, -1e308, 0.0]), None),
            id="no measurement",
        ),
    ],
)
def test_one_odd_sample_costs_at_most_the_turn_across_it(odd) -> None:
    known = sensor(range(0, 101 * MS, 5 * MS))
    known.add(odd(100 * MS))
    for stamp in range(105 * MS, 301 * MS, 5 * MS):
        known.add(sample(stamp))
    assert turn_error(known, 120 * MS, 280 * MS) < 2e-4


def test_across_missing_samples_no_turn_is_told() -> None:
    known = sensor(range(0, 101 * MS, 5 * MS))
    before = known.at(90 * MS)
    for stamp in range(300 * MS, 401 * MS, 5 * MS):
        known.add(sample(stamp))
    after = known.at(390 * MS)
    assert after is not None and after.turn_since(before) is None
    assert after.turn_since(None) is None


def test_hours_of_samples_stay_as_exact_as_the_first() -> None:
    known, rate = InertialSensor("camera", [EDGE]), np.array([0.0, 0.0, 1.5])
    for stamp in range(0, 45_000 * MS, MS):
        known.add(ImuRecord(stamp, "imu", rate))
    before, after = known.at(44_100 * MS), known.at(44_900 * MS)
    assert before is not None and after is not None
    turn = after.turn_since(before)
    true = MOUNTED.T @ Rotation.from_rotvec(0.8 * rate).as_matrix() @ MOUNTED
    np.testing.assert_allclose(turn, true, atol=1e-9)
    assert known.at(1_000 * MS) is None  # memory is bounded
