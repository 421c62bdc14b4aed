from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import CalibrationError, ConfigError, InvalidInputError
from infomap_ros.stereo import PACKED_FIELDS, StereoConfig, StereoRangeSensor

NEAR = StereoConfig(min_depth=0.5, max_depth=5.0)


@pytest.mark.parametrize(("blur", "limit"), [(0.8, 0.1), (2.0, 0.15), (4.0, 0.4)])
def test_measures_known_disparities(render, blur, limit):
    scene = render(blur=blur)
    cloud = StereoRangeSensor(scene.rig, NEAR).measure(scene.left, scene.right)
    error = (cloud.disparity - scene.disparity)[cloud.valid]
    assert cloud.density > 0.6
    assert np.mean(np.abs(error) > 3.0) < 0.001
    assert np.sqrt(np.mean(error[np.abs(error) <= 3.0] ** 2)) < limit


@pytest.mark.parametrize(
    ("blur", "noise"), [(0.8, 1.0), (0.8, 10.0), (2.0, 10.0), (3.0, 6.0), (4.0, 4.0)]
)
def test_sigma_is_never_overconfident_on_scenes_that_it_was_not_fitted_to(render, blur, noise):
    scene = render(seed=3, blur=blur, noise=noise)
    cloud = StereoRangeSensor(scene.rig, NEAR).measure(scene.left, scene.right)
    error = np.abs(cloud.disparity - scene.disparity)
    inliers = cloud.valid & (error <= 3.0)
    ratio = (error / cloud.disparity_sigma)[inliers]
    assert inliers.sum() > 10_000
    for multiple, share in ((1, 0.6827), (2, 0.9545), (3, 0.9973)):
        assert np.mean(ratio <= multiple) > share - 0.05


def test_sigma_grows_with_image_noise(render):
    sigmas = []
    for noise in (1.0, 10.0):
        scene = render(noise=noise)
        cloud = StereoRangeSensor(scene.rig, NEAR).measure(scene.left, scene.right)
        sigmas.append(np.nanmedian(cloud.disparity_sigma))
    assert sigmas[1] > 1.5 * sigmas[0]


def test_points_lie_on_the_rays_of_their_pixels_at_the_measured_depth(render):
    scene = render()
    cloud = StereoRangeSensor(scene.rig, NEAR).measure(scene.left, scene.right)
    v, u = np.nonzero(cloud.valid)
    pixels = scene.rig.left.project(cloud.points)
    np.testing.assert_allclose(pixels, np.column_stack([u, v]), atol=1e-3)
    np.testing.assert_array_equal(cloud.points[:, 2], cloud.range_image[cloud.valid])


def test_depth_is_right_to_a_percent(render):
    scene = render()
    cloud = StereoRangeSensor(scene.rig, NEAR).measure(scene.left, scene.right)
    true = scene.rig.depth_from_disparity(scene.disparity)
    error = (cloud.range_image / true - 1.0)[cloud.valid]
    assert abs(np.median(error)) < 0.002
    assert np.quantile(np.abs(error), 0.95) < 0.01


@pytest.mark.parametrize("model", ["disparity", "printed"])
def test_covariances_are_symmetric_and_positive_definite(render, model):
    scene = render()
    config = StereoConfig(max_depth=5.0, noise_model=model, printed_rho=(0.2, -0.3, 0.4))
    cloud = StereoRangeSensor(scene.rig, config).measure(scene.left, scene.right)
    assert cloud.covariances.shape == (cloud.points.shape[0], 3, 3)
    np.testing.assert_array_equal(cloud.covariances, cloud.covariances.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(cloud.covariances.astype(np.float64)).min() > 0.0


def test_printed_model_is_equation_1_and_2(render):
    scene = render()
    t, rho, n = (0.2, 0.3, 1.1), (0.2, -0.3, 0.4), 1.7
    config = StereoConfig(
        noise_model="printed", printed_s=0.5, printed_t=t, printed_n=n, printed_rho=rho
    )
    cloud = StereoRangeSensor(scene.rig, config).measure(scene.left, scene.right)
    distance = np.linalg.norm(cloud.points.astype(np.float64), axis=1)
    intrinsic = 0.5 / (scene.rig.left.fx * scene.rig.baseline)
    sigma = intrinsic * np.array(t) * distance[:, None] ** n
    correlation = np.array([[1, rho[0], rho[1]], [rho[0], 1, rho[2]], [rho[1], rho[2], 1]])
    expected = correlation * sigma[:, :, None] * sigma[:, None, :]
    np.testing.assert_allclose(cloud.covariances, expected, rtol=1e-4)


def test_invalid_pixels_are_nan_everywhere(render):
    scene = render()
    cloud = StereoRangeSensor(scene.rig, NEAR).measure(scene.left, scene.right)
    geometry = [i for i, name in enumerate(PACKED_FIELDS) if name != "rgb"]
    assert 0 < np.count_nonzero(cloud.valid) < cloud.valid.size
    assert np.isnan(cloud.packed[~cloud.valid][:, geometry]).all()
    assert np.isfinite(cloud.packed[cloud.valid][:, geometry]).all()
    for plane in (cloud.disparity, cloud.disparity_sigma):
        np.testing.assert_array_equal(np.isfinite(plane), cloud.valid)


def test_a_blank_wall_measures_nothing(render):
    scene = render()
    blank = np.full_like(scene.left, 128)
    assert StereoRangeSensor(scene.rig, NEAR).measure(blank, blank).density == 0.0


def test_unrelated_images_measure_next_to_nothing(render):
    first, second = render(seed=1), render(seed=2)
    cloud = StereoRangeSensor(first.rig, NEAR).measure(first.left, second.right)
    assert cloud.density < 0.02


def test_a_color_pair_measures_as_its_gray_pair_and_keeps_its_colors(render):
    scene = render()
    sensor = StereoRangeSensor(scene.rig, NEAR)
    gray = sensor.measure(scene.left, scene.right)
    colored = sensor.measure(
        *(np.repeat(i[..., None], 3, axis=2) for i in (scene.left, scene.right))
    )
    np.testing.assert_array_equal(gray.range_image, colored.range_image)
    assert gray.colors is None
    np.testing.assert_array_equal(colored.colors[..., 0], scene.left)


def test_extended_search_measures_the_left_columns(render):
    scene = render()
    cloud = StereoRangeSensor(scene.rig, NEAR).measure(scene.left, scene.right)
    band = slice(40, 60)  # left of min_depth's 60 px, right of the scene's own disparity
    assert cloud.valid[:, band].mean() > 0.3
    error = np.abs(cloud.disparity - scene.disparity)[:, band]
    assert np.nanquantile(error, 0.99) < 0.5


def test_threads_do_not_change_the_result(render):
    scene = render()
    clouds = [
        StereoRangeSensor(scene.rig, StereoConfig(threads=n)).measure(scene.left, scene.right)
        for n in (1, 3)
    ]
    np.testing.assert_array_equal(clouds[0].valid, clouds[1].valid)
    np.testing.assert_allclose(clouds[0].points, clouds[1].points, rtol=1e-5)
    np.testing.assert_allclose(clouds[0].covariances, clouds[1].covariances, rtol=1e-3)


def test_depths_beyond_the_wanted_range_are_dropped(render):
    scene = render()
    config = StereoConfig(min_depth=0.8, max_depth=1.1)
    cloud = StereoRangeSensor(scene.rig, config).measure(scene.left, scene.right)
    assert cloud.density > 0.1
    assert cloud.points[:, 2].min() >= 0.8
    assert cloud.points[:, 2].max() <= 1.1


@pytest.mark.parametrize(
    ("image", "error"),
    [
        (np.zeros((240, 320), np.float32), InvalidInputError),
        (np.zeros((240, 320), np.uint16), InvalidInputError),
        (np.zeros((240, 320, 4), np.uint8), InvalidInputError),
        (np.zeros(320, np.uint8), InvalidInputError),
        (np.zeros((239, 320), np.uint8), CalibrationError),
    ],
)
def test_wrong_images_are_refused_by_name(render, image, error):
    scene = render()
    with pytest.raises(error, match="right image"):
        StereoRangeSensor(scene.rig, NEAR).measure(scene.left, image)


@pytest.mark.parametrize(
    ("values", "parameter"),
    [
        ({"min_depth": 2.0, "max_depth": 1.0}, "max_depth"),
        ({"printed_t": (1.0, 1.0)}, "printed_t"),
        ({"printed_rho": (0.9, 0.9, -0.9)}, "printed_rho"),
        ({"noise_model": "none"}, "noise_model"),
    ],
)
def test_impossible_configurations_are_refused(values, parameter):
    with pytest.raises(ConfigError) as caught:
        StereoConfig(**values)
    assert caught.value.parameter == parameter
