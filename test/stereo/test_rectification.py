from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from infomap_ros.errors import CalibrationError, InvalidInputError
from infomap_ros.geometry import CameraCalibration, make_transform
from infomap_ros.stereo import (
    StereoConfig,
    StereoRangeSensor,
    StereoRectifier,
    is_rectified,
    rectify_calibrations,
)

K = np.array([[300.0, 0.0, 322.0], [0.0, 305.0, 236.0], [0.0, 0.0, 1.0]])
DISTORTIONS = {
    "plumb_bob": [-0.2, 0.05, 0.001, -0.002, 0.01],
    "rational_polynomial": [0.1, -0.05, 0.001, -0.001, 0.01, 0.2, -0.03, 0.005],
    "equidistant": [0.01, -0.01, 0.006, -0.002],
}
T_RIGHT_LEFT = make_transform(
    cv2.Rodrigues(np.array([0.03, -0.02, 0.01]))[0], np.array([-0.12, 0.004, 0.003])
)


def raw_pair(model):
    shared = {"distortion_model": model, "distortion": DISTORTIONS[model]}
    left = CameraCalibration(640, 480, intrinsics=K, **shared)
    right = replace(left, intrinsics=K + np.array([[4.0, 0, -5.0], [0, 2.0, 3.0], [0, 0, 0]]))
    return left, right


def project_raw(calibration, points):
    """Pixels of points in the raw camera frame, by OpenCV's projection (not its maps)."""
    zero, model = np.zeros(3), calibration.distortion_model
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    flat = points.reshape(-1, 1, 3)
    k, d = calibration.intrinsics, calibration.distortion
    arguments = (zero, zero, k, d)
    return project(flat, *arguments)[0].reshape(-1, 2)


def dots(pixels):
    """Image of soft dots at the given pixels."""
    image = np.zeros((480, 640))
    v, u = np.mgrid[0:480, 0:640]
    for x, y in pixels:
        image += 200.0 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2.0 * 2.0**2))
    return np.clip(image, 0, 255).astype(np.uint8)


def center_near(image, pixel):
    """Center of mass of the dot around a pixel."""
    x, y = np.rint(pixel).astype(int)
    patch = image[y - 7 : y + 8, x - 7 : x + 8].astype(float)
    v, u = np.mgrid[y - 7 : y + 8, x - 7 : x + 8]
    return np.array([(u * patch).sum(), (v * patch).sum()]) / patch.sum()


@pytest.mark.parametrize("model", sorted(DISTORTIONS))
def test_rectified_dots_lie_where_the_rig_projects_their_points(model):
    raw = raw_pair(model)
    left, right = rectify_calibrations(*raw, T_RIGHT_LEFT)
    points = np.array([[-0.4, -0.3, 1.5], [0.3, 0.2, 1.2], [0.5, -0.4, 2.0], [0.0, 0.0, 1.0]])
    in_right = points @ T_RIGHT_LEFT[:3, :3].T + T_RIGHT_LEFT[:3, 3]
    images = [dots(project_raw(c, p)) for c, p in zip(raw, (points, in_right), strict=True)]
    rectifier = StereoRectifier(left, right)
    rectified = rectifier.rectify(*images)
    turned = points @ left.rectification.T
    expected_left = rectifier.rig.left.project(turned)
    expected_right = rectifier.rig.right.project(turned - [rectifier.rig.baseline, 0.0, 0.0])
    for image, expected in zip(rectified, (expected_left, expected_right), strict=True):
        found = np.array([center_near(image, pixel) for pixel in expected])
        np.testing.assert_allclose(found, expected, atol=0.15)
    np.testing.assert_allclose(expected_left[:, 1], expected_right[:, 1], atol=1e-9)
    disparity = expected_left[:, 0] - expected_right[:, 0]
    np.testing.assert_allclose(rectifier.rig.depth_from_disparity(disparity), turned[:, 2])


def test_a_right_image_without_colors_is_that_of_the_colored_one(rng):
    left, right = rectify_calibrations(*raw_pair("plumb_bob"), T_RIGHT_LEFT)
    shape = (left.height, left.width, 3)
    images = [rng.integers(0, 256, shape).astype(np.uint8) for _ in range(2)]
    rectifier = StereoRectifier(left, right)
    colored = rectifier.rectify(*images)
    pair = rectifier.rectify(*images, gray_right=True)
    np.testing.assert_array_equal(pair[0], colored[0])
    assert pair[1].shape == shape[:2]
    difference = pair[1].astype(int) - cv2.cvtColor(colored[1], cv2.COLOR_RGB2GRAY)
    assert np.abs(difference).max() <= 2  # what rounding in another order makes


def test_rotations_bring_both_cameras_to_one_orientation():
    left, right = rectify_calibrations(*raw_pair("plumb_bob"), T_RIGHT_LEFT)
    turn = right.rectification @ T_RIGHT_LEFT[:3, :3] @ left.rectification.T
    np.testing.assert_allclose(turn, np.eye(3), atol=1e-12)
    offset = right.rectification @ T_RIGHT_LEFT[:3, 3]
    baseline = np.linalg.norm(T_RIGHT_LEFT[:3, 3])
    np.testing.assert_allclose(offset, [-baseline, 0.0, 0.0], atol=1e-12)
    assert StereoRectifier(left, right).rig.baseline == pytest.approx(baseline)


def test_real_fisheye_rows_correspond_and_the_room_has_its_size(real_data):
    folder = real_data / "tumvi_room1"
    chain = yaml.safe_load((folder / "camchain.yaml").read_text())
    left, right = rectify_calibrations(
        *(_kalibr(chain[name]) for name in ("cam0", "cam1")),
        chain["cam1"]["T_cn_cnm1"],
        focal_length=300.0,
    )
    rectifier = StereoRectifier(left, right)
    name = sorted((folder / "cam0").iterdir())[0].name
    raw = [cv2.imread(str(folder / c / name), cv2.IMREAD_UNCHANGED) for c in ("cam0", "cam1")]
    pair = rectifier.rectify(*((image >> 8).astype(np.uint8) for image in raw))
    orb = cv2.ORB_create(500)
    (first, a), (second, b) = (orb.detectAndCompute(image, None) for image in pair)
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(a, b)
    good = [m for m in matches if m.distance < 30]
    rows = [first[m.queryIdx].pt[1] - second[m.trainIdx].pt[1] for m in good]
    assert len(good) > 50
    assert abs(np.median(rows)) < 0.5
    cloud = StereoRangeSensor(rectifier.rig, StereoConfig()).measure(*pair)
    assert cloud.density > 0.15  # much of the room is too dark to show more than noise
    assert 0.5 < np.median(cloud.points[:, 2]) < 4.0


def _kalibr(camera):
    fx, fy, cx, cy = camera["intrinsics"]
    k = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    distortion = camera["distortion_coeffs"]
    return CameraCalibration(*camera["resolution"], "equidistant", distortion, k)


def test_an_ideal_camera_is_already_rectified():
    ideal = CameraCalibration(640, 480, intrinsics=K, projection=np.c_[K, np.zeros(3)])
    assert is_rectified(ideal)
    assert not is_rectified(replace(ideal, distortion=[0.1, 0.0, 0.0, 0.0, 0.0]))
    assert not is_rectified(replace(ideal, rectification=T_RIGHT_LEFT[:3, :3]))


def test_impossible_calibrations_are_refused():
    left, right = rectify_calibrations(*raw_pair("plumb_bob"), T_RIGHT_LEFT)
    with pytest.raises(CalibrationError, match="'fov'"):
        StereoRectifier(replace(left, distortion_model="fov"), right)
    with pytest.raises(CalibrationError, match="3 distortion coefficients"):
        StereoRectifier(replace(left, distortion=[0.1, 0.1, 0.1]), right)
    with pytest.raises(CalibrationError, match="R is not a rotation"):
        StereoRectifier(replace(left, rectification=2.0 * np.eye(3)), right)
    with pytest.raises(CalibrationError, match="focal lengths"):
        StereoRectifier(replace(left, intrinsics=np.diag([0.0, 0.0, 1.0])), right)
    with pytest.raises(CalibrationError, match="swapped"):
        StereoRectifier(right, left)


def test_impossible_extrinsics_are_refused():
    pair = raw_pair("plumb_bob")
    with pytest.raises(CalibrationError, match="no baseline"):
        rectify_calibrations(*pair, np.eye(4))
    with pytest.raises(CalibrationError, match="swapped"):
        rectify_calibrations(*pair, np.linalg.inv(T_RIGHT_LEFT))
    with pytest.raises(InvalidInputError, match="T_right_left"):
        rectify_calibrations(*pair, 2.0 * np.eye(4))


def test_images_of_another_size_are_refused():
    rectifier = StereoRectifier(*rectify_calibrations(*raw_pair("plumb_bob"), T_RIGHT_LEFT))
    with pytest.raises(CalibrationError, match="left image is 320x240"):
        rectifier.rectify(np.zeros((240, 320), np.uint8), np.zeros((480, 640), np.uint8))
