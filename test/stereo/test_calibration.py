"""The noise models against pairs with truth."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from infomap_ros.cli.calibrate_noise_command import draw_noise_fit
from infomap_ros.errors import CalibrationError, InvalidInputError
from infomap_ros.stereo import StereoConfig
from infomap_ros.stereo.calibration import calibrate_noise
from infomap_ros.stereo.evaluation import (
    GAUSSIAN_SHARES,
    PairErrors,
    StereoPair,
    load_pairs,
    measure_errors,
)


@pytest.fixture(scope="module")
def real_errors(real_data) -> list[PairErrors]:
    """Errors of the defaults on the real pairs at both sizes."""
    folders = (real_data / "stereo_motorcycle", real_data / "stereo_opencv_samples")
    pairs = [pair for folder in folders for pair in load_pairs(folder)]
    assert [pair.name for pair in pairs] == ["motorcycle", "aloe"]
    sizes = [*pairs, *(pair.halved() for pair in pairs)]
    return [measure_errors(pair, StereoConfig()) for pair in sizes]


@pytest.mark.parametrize("index", range(4))
def test_shares_within_predicted_sigma_are_a_gaussians_within_5_points(real_errors, index):
    found = real_errors[index].shares()
    assert np.abs(np.subtract(found, GAUSSIAN_SHARES)).max() < 0.05, found


@pytest.mark.parametrize("index", range(4))
def test_bad_pixels_are_at_most_half_of_the_plain_matchers(real_errors, index):
    errors = real_errors[index]
    assert errors.bad <= 0.5 * errors.plain_bad
    assert errors.density > 0.65


def test_errors_of_neighbors_are_correlated_as_the_default_says(real_errors):
    mean = np.mean([errors.error_correlation() for errors in real_errors])
    assert mean == pytest.approx(StereoConfig().error_correlation, abs=0.02)


def as_pair(scene, name) -> StereoPair:
    return StereoPair(
        name, scene.left, scene.right, scene.disparity.astype(np.float32), scene.rig, 48
    )


def test_calibration_makes_the_shares_of_other_scenes_gaussian(render, tmp_path):
    fit = calibrate_noise([as_pair(render(seed=i, blur=2.0), f"s{i}") for i in (1, 2)])
    other = measure_errors(as_pair(render(seed=9, blur=2.0), "other"), fit.config)
    assert np.abs(np.subtract(other.shares(), GAUSSIAN_SHARES)).max() < 0.05
    defaults = measure_errors(as_pair(render(seed=9, blur=2.0), "other"), StereoConfig())
    assert defaults.shares()[0] > 0.9  # sharper than the real pairs: the defaults are cautious
    assert fit.table().count("\n") == 1 + 4
    assert fit.summary()["sigma_scale"] == fit.config.sigma_scale
    draw_noise_fit(fit, tmp_path / "fit.png")
    assert cv2.imread(str(tmp_path / "fit.png")).std() > 5.0


def test_error_correlation_tells_independent_from_shared_errors(render, rng):
    errors = measure_errors(as_pair(render(), "s"), StereoConfig())
    shape = errors.error.shape
    patches = np.kron(rng.standard_normal((6, 8)), np.ones((40, 40)))[: shape[0], : shape[1]]
    patches *= 0.5 / patches.std()
    noise = 0.5 * rng.standard_normal(shape)
    independent = replace(errors, error=noise, kept=np.ones(shape, bool))
    shared = replace(independent, error=patches)
    half = replace(independent, error=patches + noise)
    assert independent.error_correlation() < 0.02
    assert shared.error_correlation() > 0.6
    assert half.error_correlation() == pytest.approx(0.5 * shared.error_correlation(), abs=0.05)


def write_middlebury(folder, scene):
    folder.mkdir()
    cv2.imwrite(str(folder / "im0.png"), scene.left)
    cv2.imwrite(str(folder / "im1.png"), scene.right)
    truth = scene.disparity.astype(np.float32)
    truth[0, 0] = np.inf
    cv2.imwrite(str(folder / "disp0.pfm"), truth)
    camera = scene.rig.left
    k = f"[{camera.fx} 0 {camera.cx}; 0 {camera.fy} {camera.cy}; 0 0 1]"
    text = f"cam0={k}\ncam1={k}\ndoffs=0\nbaseline=100.0\nndisp=48\n"
    (folder / "calib.txt").write_text(text)


def test_a_middlebury_folder_is_read_as_it_was_written(render, tmp_path):
    scene = render()
    write_middlebury(tmp_path / "scene", scene)
    (pair,) = load_pairs(tmp_path / "scene")
    assert pair.name == "scene"
    assert pair.rig == scene.rig
    assert pair.disparities == 48
    assert np.isnan(pair.truth[0, 0])
    np.testing.assert_allclose(pair.truth[1:], scene.disparity[1:], rtol=1e-6)
    np.testing.assert_array_equal(pair.left[..., 0], scene.left)


def test_incomplete_folders_are_refused_by_name(render, tmp_path):
    with pytest.raises(InvalidInputError, match="no stereo pair"):
        load_pairs(tmp_path)
    folder = tmp_path / "scene"
    write_middlebury(folder, render())
    (folder / "calib.txt").write_text("cam0=[1 0 0; 0 1 0; 0 0 1]\n")
    with pytest.raises(CalibrationError, match=r"calib\.txt"):
        load_pairs(folder)
    (folder / "calib.txt").unlink()
    with pytest.raises(CalibrationError, match="no calib"):
        load_pairs(folder)
    (folder / "im1.png").unlink()
    with pytest.raises(InvalidInputError, match=r"im1\.png"):
        load_pairs(folder)


def test_nothing_to_calibrate_is_refused(render):
    with pytest.raises(InvalidInputError, match="pairs"):
        calibrate_noise([])
    blank = np.full((240, 320), 100, np.uint8)
    pair = replace(as_pair(render(), "blank"), left=blank, right=blank)
    with pytest.raises(InvalidInputError, match="blank"):
        calibrate_noise([pair])
