from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.errors import CalibrationError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.localization.fiducials.range_view import DepthView, StereoView
from infomap_ros.localization.fiducials.sparse_stereo import (
    correlate,
    match_pixels,
)
from infomap_ros.stereo import (
    DepthCameraConfig,
    DepthCameraSensor,
    StereoConfig,
    StereoRangeSensor,
)
from infomap_ros.stereo.evaluation import load_pairs
from test.localization.textured_plane import CAMERA, RIG, SENSOR, TexturedPlane, camera_at


def grid(step: int = 13, offset: float = 0.0) -> np.ndarray:
    u, v = np.meshgrid(np.arange(60, 300, step), np.arange(20, 220, step))
    return np.column_stack([u.ravel(), v.ravel()]) + offset


def test_correlation_is_that_of_numpy(rng: np.random.Generator) -> None:
    image, other = rng.integers(0, 256, (2, 30, 60), dtype=np.uint8)
    scores = np.empty(25, np.float32)
    correlate(image, other, 30, 12, -5, -1, 3, scores)
    window = image[9:16, 27:34].astype(float).ravel()
    for index, shift in enumerate(range(-5, 20)):
        there = other[9:16, 27 - shift : 34 - shift].astype(float).ravel()
        assert scores[index] == pytest.approx(np.corrcoef(window, there)[0, 1], abs=1e-5)


@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_sparse_stereo_measures_a_slanted_plane_within_its_sigma(offset: float) -> None:
    plane, pose = TexturedPlane(), camera_at([0.1, 0.0, 0.2])
    pixels = grid(offset=offset)
    inverse, sigma = plane.view(pose).inverse_depths(pixels)
    errors = inverse - plane.inverse_depths(pose, pixels)
    found = np.isfinite(inverse)
    assert found.mean() > 0.9
    assert np.abs(np.mean(errors[found])) < 0.02 / (CAMERA.fx * RIG.baseline)
    assert np.quantile(np.abs(errors[found]), 0.68) < 0.06 / (CAMERA.fx * RIG.baseline)
    shares = [(np.abs(errors[found] / sigma[found]) < k).mean() for k in (1, 2, 3)]
    assert shares[0] > 0.68
    assert shares[1] > 0.95
    assert shares[2] > 0.99


def test_cameras_may_be_exposed_differently() -> None:
    plane, pose = TexturedPlane(), camera_at([0.0, 0.0, 0.0])
    left = plane.expose(plane.light(pose))
    right = plane.expose(0.7 * plane.light(camera_at([RIG.baseline, 0.0, 0.0])) + 30.0)
    pixels = grid()
    inverse, _ = StereoView(0, left, right, SENSOR).inverse_depths(pixels)
    errors = (inverse - plane.inverse_depths(pose, pixels)) * CAMERA.fx * RIG.baseline
    assert np.isfinite(errors).mean() > 0.9
    assert np.nanquantile(np.abs(errors), 0.68) < 0.08


@pytest.mark.parametrize("rows_off", [-0.4, 0.4])
def test_rows_that_differ_are_not_taken_for_disparity(
    rows_off: float, rng: np.random.Generator
) -> None:
    """Edges that run at 45 degrees would turn all of the difference into disparity."""
    stretched = cv2.GaussianBlur(rng.normal(0, 1, (700, 700)), (0, 0), sigmaX=6.0, sigmaY=1.5)
    turn = cv2.getRotationMatrix2D((350.0, 350.0), 45.0, 1.0)
    slanted = cv2.warpAffine(stretched, turn, (700, 700))[200:460, 180:540]
    scene = np.clip(128.0 + 40.0 * slanted / slanted.std(), 0.0, 255.0)
    shift = np.array([[1.0, 0.0, -20.3], [0.0, 1.0, rows_off]])
    right = cv2.warpAffine(scene, shift, scene.shape[::-1], flags=cv2.INTER_CUBIC)
    left, right = (np.rint(image[10:250, 30:350]).clip(0, 255) for image in (scene, right))
    view = StereoView(0, left.astype(np.uint8), right.astype(np.uint8), SENSOR)
    inverse, _ = view.inverse_depths(grid())
    errors = inverse * CAMERA.fx * RIG.baseline - 20.3
    assert np.isfinite(errors).mean() > 0.5
    assert abs(np.nanmedian(errors)) < 0.1


def test_there_is_no_range_without_texture_beyond_the_image_or_in_repetition() -> None:
    u, v = np.meshgrid(np.arange(320), np.arange(240))
    flat = np.full((240, 320), 90, np.uint8)
    stripes = (120 + 60 * np.sin(u / 2.0) * np.sin(v / 2.0)).astype(np.uint8)  # period 12.6 px
    pixels = np.array([[150.0, 100.0], [-4.0, 20.0], [3.0, 100.0], [319.0, 239.0], [np.nan, 5.0]])
    for image in (flat, stripes):
        inverse, sigma = StereoView(0, image, image, SENSOR).inverse_depths(pixels)
        assert np.isnan(inverse).all()
        assert np.isnan(sigma).all()


def test_what_the_right_camera_does_not_see_has_no_range() -> None:
    """A near square hides part of the background from the right camera only."""
    rng = np.random.default_rng(1)
    left = cv2.GaussianBlur(rng.normal(0, 1, (240, 320)), (0, 0), 1.5)
    left = np.clip(128 + 40 * left / left.std(), 0, 255).astype(np.uint8)
    square = left[80:160, 140:200]
    right = np.roll(left, -4, axis=1)
    right[80:160, 110:170] = square  # disparity 30 against 4
    hidden = np.array([[u, 120.0] for u in range(120, 132, 3)])
    inverse, _ = StereoView(0, left, right, SENSOR).inverse_depths(hidden)
    assert np.isnan(inverse).all()
    seen = np.array([[170.0, 120.0], [250.0, 120.0]])
    inverse, _ = StereoView(0, left, right, SENSOR).inverse_depths(seen)
    assert np.allclose(inverse * CAMERA.fx * RIG.baseline, [30.0, 4.0], atol=0.15)


def test_principal_offset_moves_infinity(rng: np.random.Generator) -> None:
    noise = cv2.GaussianBlur(rng.normal(0, 1, (240, 340)), (0, 0), 1.5)
    scene = np.clip(128 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)
    right_camera = PinholeCamera(320, 240, 260.0, 260.0, 159.5 + 12.0, 119.5)
    sensor = StereoRangeSensor(StereoRig(CAMERA, right_camera, 0.1), StereoConfig(min_depth=0.8))
    view = StereoView(0, scene[:, 10:330], scene[:, :320], sensor)  # disparity -10
    inverse, _ = view.inverse_depths([[160.0, 100.0]])
    assert inverse[0] * 26.0 == pytest.approx(2.0, abs=0.1)


def test_the_dense_cloud_is_worked_out_once() -> None:
    view = TexturedPlane().view(camera_at([0.0, 0.0, 0.0]))
    assert not view.has_cloud
    assert view.cloud() is view.cloud()
    assert view.has_cloud
    assert view.cloud().density > 0.5


def test_views_refuse_images_and_pixels_that_do_not_fit() -> None:
    image = np.zeros((240, 320), np.uint8)
    with pytest.raises(CalibrationError, match="left image"):
        StereoView(0, image[:100], image, SENSOR)
    with pytest.raises(InvalidInputError, match="right image"):
        StereoView(0, image, image.astype(float), SENSOR)
    with pytest.raises(InvalidInputError, match="pixels"):
        StereoView(0, image, image, SENSOR).inverse_depths([[1.0, 2.0, 3.0]])


def test_depth_view_is_exact_on_a_plane_between_pixels() -> None:
    plane, pose = TexturedPlane(), camera_at([0.0, 0.1, 0.0])
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    every = np.column_stack([u.ravel(), v.ravel()])
    depth = (1.0 / plane.inverse_depths(pose, every)).reshape(240, 320)
    depth[100:140, 200:240] = np.nan
    cloud = DepthCameraSensor(CAMERA).measure(depth)
    view = DepthView(5, np.zeros((240, 320, 3), np.uint8), cloud)
    pixels = np.array([[50.3, 60.8], [120.0, 200.5], [220.0, 120.0], [1.0, 1.0], [400.0, 10.0]])
    inverse, sigma = view.inverse_depths(pixels)
    assert np.allclose(inverse[:2], plane.inverse_depths(pose, pixels[:2]), rtol=1e-5)
    assert np.isnan(inverse[2:]).all()
    assert np.isnan(sigma[2:]).all()
    assert view.has_cloud
    assert view.stamp == 5


def test_sigma_of_a_depth_view_is_that_of_repeated_measurements(
    rng: np.random.Generator,
) -> None:
    config = DepthCameraConfig(sigma_base=0.01, sigma_quadratic=0.0, error_correlation=0.0)
    sensor = DepthCameraSensor(CAMERA, config)
    image = np.zeros((240, 320), np.uint8)
    pixels = grid(20)
    measured = []
    for _ in range(30):
        depth = rng.normal(2.0, 0.01, (240, 320))
        measured.append(DepthView(0, image, sensor.measure(depth)).inverse_depths(pixels))
    spread = np.std([inverse for inverse, _ in measured], axis=0).mean()
    stated = np.mean([sigma for _, sigma in measured])
    assert stated == pytest.approx(spread, rel=0.35)


def test_sigma_holds_on_the_real_motorcycle(real_data: Path) -> None:
    (pair,) = load_pairs(real_data / "stereo_motorcycle")
    left, right = (cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) for i in (pair.left, pair.right))
    window, truth = np.ones((13, 13), np.uint8), np.nan_to_num(pair.truth, nan=-100.0)
    smooth = (cv2.dilate(truth, window) - cv2.erode(truth, window) < 6.0).astype(np.uint8)
    corners = cv2.goodFeaturesToTrack(left, 400, 0.005, 8, mask=smooth)[:, 0].astype(float)
    disparity, sigma = match_pixels(left, right, corners, (-40, 230))
    around = [pair.truth[v - 2 : v + 3, u - 2 : u + 3] for u, v in corners.astype(int)]
    errors = disparity - np.array([window.mean() for window in around])
    right_ones = np.abs(errors) < 3.0
    assert np.isfinite(disparity).mean() > 0.6
    assert right_ones[np.isfinite(errors)].mean() > 0.9
    shares = [(np.abs(errors / sigma)[right_ones] < k).mean() for k in (1, 2)]
    assert 0.5 < shares[0] < 0.8
    assert shares[1] > 0.8
