from __future__ import annotations

import cv2
import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.localization.fiducials.appearance import (
    SCALES,
    corners_of,
    describe,
    find_again,
    gradient_histograms,
)
from test.localization.textured_plane import TexturedPlane, camera_at

START = camera_at([0.0, 0.0, 0.0])


def naive_histogram(image: np.ndarray, u: float, v: float, spacing: float) -> np.ndarray:
    """One descriptor at full size, by interpolation from scratch."""
    blurred = cv2.GaussianBlur(image, (0, 0), 0.8)
    offsets = (np.arange(18) - 8.5) * spacing
    x, y = np.meshgrid(u + offsets, v + offsets)
    patch = cv2.remap(
        blurred.astype(np.float32),
        x.astype(np.float32),
        y.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    cells = np.zeros((6, 6, 8))
    for j in range(16):
        for i in range(16):
            du = patch[j + 1, i + 2] - patch[j + 1, i]
            dv = patch[j + 2, i + 1] - patch[j, i + 1]
            a, b = (i - 7.5) / 4.0, (j - 7.5) / 4.0
            weight = np.hypot(du, dv) * np.exp(-(a * a + b * b) / 8.0)
            for cu in range(6):
                for cv in range(6):
                    share = max(0.0, 1 - abs(a + 2.5 - cu)) * max(0.0, 1 - abs(b + 2.5 - cv))
                    for k in range(8):
                        turn = (np.arctan2(dv, du) * 4 / np.pi - k + 4) % 8 - 4
                        cells[cv, cu, k] += weight * share * max(0.0, 1 - abs(turn))
    histogram = cells[1:5, 1:5].ravel()
    return 255.0 * np.sqrt(histogram / histogram.sum())


@pytest.fixture(scope="module")
def plane() -> TexturedPlane:
    return TexturedPlane()


def apart(pixels: np.ndarray, count: int) -> np.ndarray:
    """The first ones that are at least 12 px from each other."""
    chosen: list[np.ndarray] = []
    for pixel in pixels:
        if len(chosen) < count and all(np.linalg.norm(pixel - one) >= 12.0 for one in chosen):
            chosen.append(pixel)
    return np.array(chosen)


def test_descriptors_are_those_of_a_naive_histogram(plane: TexturedPlane) -> None:
    image = plane.expose(plane.light(START))
    pixels = np.array([[100.0, 80.0], [5.3, 200.6], [310.0, 3.0]])
    described = gradient_histograms(image, pixels, (1.0, 1.4))
    for row, (u, v) in enumerate(pixels):
        for scale, spacing in enumerate((1.0, 1.4)):
            naive = naive_histogram(image, u, v, spacing)
            assert np.abs(described[row, scale] - naive).max() < 6.0


def test_brightness_and_contrast_do_not_matter(plane: TexturedPlane) -> None:
    light = plane.light(START)
    pixels = corners_of(plane.expose(light))[:50]
    bright = describe(plane.expose(light), pixels).astype(float)
    dark = describe(plane.expose(0.6 * light + 5.0), pixels).astype(float)
    same = np.linalg.norm(bright - dark, axis=1)
    other = np.linalg.norm(bright - np.roll(dark, 1, axis=0), axis=1)
    assert np.quantile(same, 0.9) < 0.4 * np.median(other)


def test_an_enlarged_image_matches_at_the_scale_of_the_enlargement(plane: TexturedPlane) -> None:
    image = plane.expose(plane.light(START))
    pixels = np.array([[u, v] for u in range(60, 260, 20) for v in range(60, 180, 20)], float)
    large = cv2.resize(image, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    original = describe(image, pixels).reshape(len(pixels), len(SCALES), -1).astype(float)
    enlarged = gradient_histograms(large, 2.0 * pixels + 0.5, (2.0,)).astype(float)
    best = np.linalg.norm(original - enlarged, axis=2).argmin(axis=1)
    assert (np.array(SCALES)[best] == 2.0).mean() > 0.9


def test_fiducials_are_found_again_from_nearer_by(plane: TexturedPlane) -> None:
    pose = camera_at([0.1, 0.0, 0.5], [0.0, 0.05, 0.0])
    before, view = plane.view(START), plane.view(pose, 1)
    pixels = apart(corners_of(before.image), 80)
    found = find_again(view, describe(before.image, pixels))
    error = np.linalg.norm(found.pixels - plane.moved(START, pose, pixels[found.indices]), axis=1)
    assert len(found.indices) > 20
    assert (error < 2.5).mean() > 0.9
    true = plane.inverse_depths(pose, found.pixels)
    scale = true / plane.inverse_depths(START, pixels[found.indices])
    assert np.median(np.abs(np.log(found.scales / scale))) < 0.3


def test_a_prediction_restricts_where_they_are_found(plane: TexturedPlane) -> None:
    view = plane.view(START)
    pixels = apart(corners_of(view.image), 30)
    described = describe(view.image, pixels)
    predicted = pixels + 3.0
    predicted[:5] = [-500.0, 0.0]
    predicted[5] = np.nan
    found = find_again(view, described, predicted, 6.0)
    assert found.indices.min() > 5
    assert (np.linalg.norm(found.pixels - predicted[found.indices], axis=1) <= 6.0).all()
    assert len(found.indices) > 15


def test_nothing_is_found_where_nothing_is_alike(plane: TexturedPlane) -> None:
    other = TexturedPlane(seed=9).view(START)
    view = plane.view(START)
    pixels = corners_of(other.image)[:100]
    found = find_again(view, describe(other.image, pixels))
    assert len(found.indices) < 8
    flat = np.full((240, 320), 100, np.uint8)
    assert not describe(flat, [[50.0, 50.0]]).any()
    assert len(find_again(view, describe(flat, pixels)).indices) == 0


def test_what_does_not_fit_is_refused(plane: TexturedPlane) -> None:
    view = plane.view(START)
    described = describe(view.image, [[50.0, 50.0]])
    with pytest.raises(InvalidInputError, match="radius"):
        find_again(view, described, [[50.0, 50.0]])
    with pytest.raises(InvalidInputError, match="predicted"):
        find_again(view, described, np.zeros((2, 2)), 5.0)
    with pytest.raises(InvalidInputError, match="descriptors"):
        find_again(view, described[:, :100])
