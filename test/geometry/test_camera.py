"""Cameras and rigs against OpenCV, numeric integration of angles, and round trips."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from infomap_ros.errors import CalibrationError
from infomap_ros.geometry import (
    CameraCalibration,
    PinholeCamera,
    StereoRig,
    rig_from_calibrations,
)

CAMERA = PinholeCamera(width=640, height=480, fx=525.0, fy=520.0, cx=310.5, cy=244.25)


def calibration(camera: PinholeCamera, baseline: float = 0.0) -> CameraCalibration:
    projection = np.hstack([camera.matrix, [[-camera.fx * baseline], [0.0], [0.0]]])
    return CameraCalibration(
        camera.width, camera.height, "plumb_bob", np.zeros(5), camera.matrix, np.eye(3), projection
    )


@pytest.mark.parametrize(
    ("row", "column", "value", "told"),
    [
        (0, 0, 4.2, r"fx = 4\.2, fy = 520 px: 178\.5 deg of view"),  # in mm
        (1, 1, 0.82, r"fy = 0\.82 px: 179\.6 deg of view"),  # as a share of the height
        (0, 1, 52.4, r"skew P\[0, 1\] is 52\.4 px"),
    ],
)
def test_what_is_not_plausible_is_named_with_its_value(row, column, value, told):
    odd = calibration(CAMERA)
    projection = odd.projection.copy()
    projection[row, column] = value
    with pytest.raises(CalibrationError, match=told):
        dataclasses.replace(odd, projection=projection).rectified_camera()


def test_project_agrees_with_opencv(rng):
    points = rng.uniform([-2.0, -2.0, 0.3], [2.0, 2.0, 6.0], size=(200, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), CAMERA.matrix, None)
    np.testing.assert_allclose(CAMERA.project(points), expected[:, 0], atol=1e-9)


def test_points_behind_the_camera_have_no_pixel():
    pixels = CAMERA.project([[0.1, 0.1, 0.0], [0.1, 0.1, -1.0], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(np.isnan(pixels[:, 0]), [True, True, False])


def test_back_projection_inverts_projection(rng):
    depth = rng.uniform(0.5, 5.0, size=(480, 640))
    pixels = CAMERA.project(CAMERA.back_project(depth))
    v, u = np.mgrid[:480, :640]
    np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-3)


def test_back_projection_keeps_what_is_not_measured():
    depth = np.full((480, 640), np.nan)
    depth[3, 5] = 2.0
    points = CAMERA.back_project(depth)
    assert np.isfinite(points).all(axis=-1).sum() == 1
    assert points[3, 5, 2] == 2.0


@pytest.mark.parametrize("shape", [(640, 480), (480,), (480, 640, 1)])
def test_depth_image_of_another_size_is_refused(shape):
    with pytest.raises(CalibrationError, match="640x480"):
        CAMERA.back_project(np.ones(shape))


def test_field_of_view_is_the_angle_between_the_outer_pixel_edges():
    edges = np.array([[-0.5, CAMERA.cy], [CAMERA.width - 0.5, CAMERA.cy]])
    rays = np.array([[(u - CAMERA.cx) / CAMERA.fx, 0.0, 1.0] for u, _ in edges])
    cosine = rays[0] @ rays[1] / np.linalg.norm(rays, axis=1).prod()
    assert CAMERA.field_of_view[0] == pytest.approx(np.arccos(cosine), abs=1e-12)
    square = PinholeCamera(100, 100, 50.0, 50.0, 49.5, 49.5)
    np.testing.assert_allclose(square.field_of_view, [np.pi / 2, np.pi / 2])


def test_scaled_camera_sees_what_the_resized_image_shows():
    """OpenCV resizes a smooth ramp of u; the scaled camera must agree on where a ray lands."""
    ramp = np.tile(np.arange(640, dtype=np.float32), (480, 1))
    half = cv2.resize(ramp, (320, 240), interpolation=cv2.INTER_AREA)
    scaled = CAMERA.scaled(0.5)
    point = np.array([0.4, 0.1, 2.0])
    u, v = scaled.project(point)
    sampled = cv2.remap(half, np.float32([[u]]), np.float32([[v]]), cv2.INTER_LINEAR)[0, 0]
    assert (scaled.width, scaled.height) == (320, 240)
    assert sampled == pytest.approx(CAMERA.project(point)[0], abs=0.05)


@pytest.mark.parametrize(
    "change",
    [{"width": 0}, {"height": -1}, {"fx": 0.0}, {"fy": -2.0}, {"cx": np.nan}, {"fx": np.inf}],
)
def test_impossible_camera_is_refused(change):
    values = {"width": 4, "height": 3, "fx": 2.0, "fy": 2.0, "cx": 1.0, "cy": 1.0} | change
    with pytest.raises(CalibrationError, match="camera"):
        PinholeCamera(**values)


def test_disparity_is_the_difference_of_two_projections(rng):
    """With principal points that differ, as rectification can leave them."""
    right = PinholeCamera(640, 480, 525.0, 520.0, 340.0, 244.25)
    rig = StereoRig(CAMERA, right, 0.12)
    points = rng.uniform([-1.0, -1.0, 0.5], [1.0, 1.0, 8.0], size=(100, 3))
    disparity = CAMERA.project(points)[:, 0] - right.project(points - [0.12, 0.0, 0.0])[:, 0]
    np.testing.assert_allclose(rig.depth_from_disparity(disparity), points[:, 2], rtol=1e-10)
    np.testing.assert_allclose(rig.disparity_from_depth(points[:, 2]), disparity, atol=1e-9)


def test_disparity_beyond_infinity_has_no_depth():
    rig = StereoRig(CAMERA, CAMERA, 0.1)
    depth = rig.depth_from_disparity([0.0, -1.0, np.nan, np.inf, 52.5])
    np.testing.assert_allclose(depth, [np.nan] * 4 + [1.0])


def test_depth_that_is_not_positive_has_no_disparity():
    rig = StereoRig(CAMERA, CAMERA, 0.1)
    np.testing.assert_allclose(
        rig.disparity_from_depth([0.0, -1.0, np.nan, 1.0, np.inf]), [np.nan] * 3 + [52.5, 0.0]
    )


@pytest.mark.parametrize("baseline", [0.0, -0.1, np.nan, np.inf])
def test_impossible_baseline_is_refused(baseline):
    with pytest.raises(CalibrationError, match="baseline"):
        StereoRig(CAMERA, CAMERA, baseline)


def test_unrectified_pair_is_refused_by_the_value_that_differs():
    lower = PinholeCamera(640, 480, 525.0, 520.0, 310.5, 247.0)
    with pytest.raises(CalibrationError, match=r"cy is 244\.25 on the left and 247\.0"):
        StereoRig(CAMERA, lower, 0.1)


def test_rig_from_camera_infos():
    rig = rig_from_calibrations(calibration(CAMERA), calibration(CAMERA, 0.125))
    assert rig == StereoRig(CAMERA, CAMERA, 0.125)


def test_rig_agrees_with_opencv_rectification():
    """P of cv2.stereoRectify in camera infos gives the baseline and Q's depth."""
    translation = np.array([[-0.12], [0.002], [-0.001]])
    rotation = cv2.Rodrigues(np.array([0.01, -0.02, 0.005]))[0]
    k = CAMERA.matrix
    _, _, p_left, p_right, q, _, _ = cv2.stereoRectify(
        k, np.zeros(5), k, np.zeros(5), (640, 480), rotation, translation
    )
    infos = [
        CameraCalibration(640, 480, "plumb_bob", np.zeros(5), k, np.eye(3), p)
        for p in (p_left, p_right)
    ]
    rig = rig_from_calibrations(*infos)
    assert rig.baseline == pytest.approx(np.linalg.norm(translation), rel=1e-9)
    point = q @ np.array([300.0, 200.0, 17.0, 1.0])
    assert rig.depth_from_disparity(17.0) == pytest.approx(point[2] / point[3], rel=1e-9)


@pytest.mark.parametrize(
    ("left", "right", "named"),
    [
        (calibration(CAMERA), calibration(CAMERA.scaled(0.5), 0.1), "320x240"),
        (calibration(CAMERA), calibration(CAMERA), "baseline"),
        (calibration(CAMERA, 0.1), calibration(CAMERA), "swapped"),
        (calibration(CAMERA), calibration(CAMERA, 75.0), "75 m.*not in meters"),
        (calibration(CAMERA), CameraCalibration(640, 480), "not calibrated"),
    ],
)
def test_camera_infos_that_do_not_fit_are_refused(left, right, named):
    with pytest.raises(CalibrationError, match=named):
        rig_from_calibrations(left, right)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"intrinsics": np.eye(4)}, "intrinsics has shape"),
        ({"projection": np.full((3, 4), np.nan)}, "projection holds NaN"),
        ({"distortion": [np.inf]}, "distortion holds NaN"),
    ],
)
def test_malformed_calibration_is_refused(change, named):
    with pytest.raises(CalibrationError, match=named):
        CameraCalibration(640, 480, **change)


def test_calibrations_compare_by_value():
    first, second = calibration(CAMERA, 0.1), calibration(CAMERA, 0.1)
    assert first == second
    assert hash(first) == hash(second)
    assert first != calibration(CAMERA, 0.2)
    assert first != "a camera"
