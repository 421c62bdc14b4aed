"""The refinement against a slow, obvious one, compiled and not."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import cv2
import numpy as np
import pytest

from infomap_ros.stereo import StereoConfig, StereoRangeSensor
from infomap_ros.stereo.images import RowBands
from infomap_ros.stereo.quality import MatchQuality, is_determined, refine
from test.stereo.conftest import make_rig

INVALID = -16


def scene(rng, height=14, width=40):
    left, right = (rng.integers(0, 256, (height, width)).astype(np.uint8) for _ in range(2))
    disparity = rng.integers(0, 16 * 12, (height, width)).astype(np.int16)
    disparity[rng.random((height, width)) < 0.2] = INVALID
    return left, right, disparity


def sample(left, right, disparity, v, u):
    """(g, e, h) of one pixel, or None where it has no place in the right image."""
    width = left.shape[1]
    place = u - disparity[v, u] / 16.0
    first = int(np.floor(place))
    if disparity[v, u] <= INVALID or not (1 <= u <= width - 2 and 1 <= first <= width - 3):
        return None
    row = right[v].astype(np.float64)
    here = np.interp(place, np.arange(width), row)
    slope = np.interp(place, np.arange(1, width - 1), (row[2:] - row[:-2]) / 2.0)
    line = left[v].astype(np.float64)
    g = 0.5 * (slope + (line[u + 1] - line[u - 1]) / 2.0)
    return g, line[u] - here, line[u - 1] - 2.0 * line[u] + line[u + 1]


def naive_refine(left, right, disparity, reach):
    height, width = left.shape
    planes = np.zeros((4, height, width))
    for v in range(height):
        for u in range(width):
            rows = range(max(0, v - reach), min(height, v + reach + 1))
            columns = range(max(0, u - reach), min(width, u + reach + 1))
            found = [sample(left, right, disparity, y, x) for y in rows for x in columns]
            g, e, h = np.array([f for f in found if f is not None] or [(0.0, 0.0, 0.0)]).T
            cross = np.mean(g * e) - g.mean() * e.mean()
            spread = g.var() + 5.0
            step = np.clip(-cross / spread, -0.5, 0.5)
            planes[:, v, u] = (
                disparity[v, u] / 16.0 + step,
                max(e.var() - cross**2 / spread, 0.0),
                np.mean(g * g),
                np.mean(h * h),
            )
    return planes


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("window", [3, 7])
def test_refinement_agrees_with_the_obvious_one(rng, window, threads):
    left, right, disparity = scene(rng)
    bands = RowBands(left.shape[0], threads)
    found = refine(left, right, disparity, INVALID, window, 1, bands)
    expected = naive_refine(left, right, disparity, window // 2)
    for plane, truth in zip(found, expected, strict=True):
        np.testing.assert_allclose(plane, truth, rtol=1e-3, atol=0.05)


def test_a_fraction_of_a_pixel_is_recovered(rng):
    u = np.arange(200.0)
    wave = 100.0 + 60.0 * np.sin(u / 1.5)
    left = np.repeat(np.rint(wave)[None], 20, axis=0).astype(np.uint8)
    right = np.repeat(np.rint(100.0 + 60.0 * np.sin((u + 10.3) / 1.5))[None], 20, axis=0)
    disparity = np.full(left.shape, 10 * 16, np.int16)
    found = refine(left, right.astype(np.uint8), disparity, INVALID, 9, 5, RowBands(20))
    middle = found.disparity[8:12, 30:170]
    assert np.abs(middle - 10.3).max() < 0.05


def test_a_match_needs_texture_and_contrast_to_what_is_left_unexplained():
    config = StereoConfig(min_texture=3.0)
    gradient = np.array([[8.9, 9.0, 20.0], [20.0, 100.0, 0.0]], np.float32)
    residual = np.array([[0.0, 0.0, 57.0], [58.0, 286.0, 0.0]], np.float32)
    quality = MatchQuality(gradient, residual, gradient, gradient)
    found = is_determined(quality, config, RowBands(2, 2))
    assert found.tolist() == [[False, True, True], [False, False, False]]


def test_kernels_run_uncompiled_with_the_same_result(rng, tmp_path):
    arrays = scene(rng)
    np.savez(tmp_path / "scene.npz", *arrays)
    script = (
        "import sys, numpy as np\n"
        "from infomap_ros.stereo import StereoConfig\n"
        "from infomap_ros.stereo.images import RowBands\n"
        "from infomap_ros.stereo.noise import sigma_from_quality\n"
        "from infomap_ros.stereo.quality import refine\n"
        "scene = list(np.load(sys.argv[1]).values())\n"
        "bands = RowBands(14)\n"
        "quality = refine(*scene, -16, 5, 3, bands)\n"
        "np.savez(sys.argv[2], *quality, sigma_from_quality(quality, StereoConfig(), bands))\n"
    )
    results = []
    for jit in ("0", "1"):
        out = tmp_path / f"{jit}.npz"
        environment = {**os.environ, "NUMBA_DISABLE_JIT": jit}
        command = [sys.executable, "-c", script, str(tmp_path / "scene.npz"), str(out)]
        subprocess.run(command, check=True, env=environment)
        results.append(list(np.load(out).values()))
    for compiled, plain in zip(*results, strict=True):
        np.testing.assert_allclose(compiled, plain, rtol=1e-3, atol=1e-3)


def test_a_hole_does_not_change_the_disparities_beside_it(rng):
    """A perfect pair with one hole: whoever is kept beside it is right."""
    shift, rig = 16, make_rig(120, 60)
    right = cv2.GaussianBlur(rng.integers(0, 256, (60, 120)).astype(np.uint8), (0, 0), 1.0)
    left = np.roll(right, shift, axis=1)
    disparity = np.full(left.shape, 16 * shift, np.int16)
    sensor = StereoRangeSensor(rig, StereoConfig(speckle_size=0))
    disparity[30:33, 70:73] = sensor._matcher.invalid
    keep, quality = sensor.assess(left, right, disparity)

    beside = keep[24:39, 64:79]
    assert beside.sum() > 15 * 15 - 7**2 - 1
    assert np.abs(quality.disparity[keep] - shift).max() < 0.01


def test_bands_end_together_when_one_fails():
    """Otherwise a thread would go on with arrays that its caller uses again."""
    begun, done = threading.Event(), []

    def work(first: int, end: int) -> None:
        if first == 0:
            begun.wait(10.0)
            raise ValueError("first band")
        begun.set()
        for _ in range(200):
            np.linalg.svd(np.ones((40, 40)))
        done.append(end)

    with pytest.raises(ValueError, match="first band"):
        RowBands(10, 2).run(work)
    assert done == [10]
