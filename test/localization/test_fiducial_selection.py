from __future__ import annotations

import cv2
import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.localization.fiducials import selection
from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.localization.fiducials.selection import (
    FiducialSelectionConfig,
    certainty,
    corner_candidates,
    depth_contrast,
    range_certainty,
    select_fiducials,
    spread_penalty,
    visual_contrast,
)
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from test.localization.textured_plane import SENSOR, TexturedPlane, camera_at

START = camera_at([0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def view() -> StereoView:
    return TexturedPlane().view(START)


def distances(pixels: np.ndarray) -> np.ndarray:
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
    return apart[np.triu_indices(len(pixels), 1)]


def test_contrast_is_that_of_eq_20_for_a_spot() -> None:
    """A bright square on gray: C grows as the window takes in more of the gray, w with it."""
    image = np.full((101, 101), 100, np.uint8)
    image[49:52, 49:52] = 200
    image[30:71, 30:71][np.abs(np.mgrid[-20:21, -20:21]).max(axis=0) > 8] = 150
    naive = {}
    for side in range(5, 32, 2):
        reach = side // 2
        mean = image[50 - reach : 51 + reach, 50 - reach : 51 + reach].mean()
        naive[side] = (200.0 - mean) / mean
    sides = [5]
    while sides[-1] < 31 and naive[sides[-1] + 2] >= naive[sides[-1]]:
        sides.append(sides[-1] + 2)
    assert 5 < sides[-1] < 31  # the contrast falls where the window meets the brighter frame
    value = visual_contrast(image, [[50.0, 50.0]], 31)
    assert value == pytest.approx([naive[sides[-1]] * sides[-1]])
    assert visual_contrast(image, [[95.0, 5.0]], 31) == pytest.approx([0.0])
    assert visual_contrast(255 - image, [[50.0, 50.0]], 31) > 1.0  # dark spots too


def test_certainty_is_probability_over_the_radius_of_falling_shells() -> None:
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=10.0))
    wall = np.stack(np.meshgrid(np.arange(-1, 1, 0.02), np.arange(-1, 1, 0.02), [2.05]), -1)
    for _ in range(6):
        voxel_map.integrate(wall.reshape(-1, 3), np.eye(4))
    on_wall, in_front, unknown = [0.05, 0.05, 2.05], [0.05, 0.05, 1.05], [0.05, 0.05, 4.05]
    points = np.array([on_wall, in_front, unknown, [np.nan] * 3])
    values = certainty(voxel_map, points, 3)
    for point, value in zip(points[:3], values, strict=False):
        shells = []
        for radius in range(4):
            reach = range(-radius, radius + 1)
            shell = [
                point + 0.1 * np.array([i, j, k])
                for i in reach
                for j in reach
                for k in reach
                if max(abs(i), abs(j), abs(k)) == radius
            ]
            shells.append(np.abs(2.0 * voxel_map.probability(np.array(shell)) - 1.0).mean())
        falling = 0
        while falling < 3 and shells[falling + 1] < shells[falling] - 0.01:
            falling += 1
        is_occupied = voxel_map.probability(np.array([point]))[0] > 0.5
        assert value == pytest.approx(is_occupied * shells[0] / max(falling, 1))
    assert values[0] > 0.3
    assert values[1:].tolist() == [0.0, 0.0, 0.0]


def test_range_certainty_falls_with_the_relative_sigma() -> None:
    values = range_certainty(np.array([1.0, 1.0, np.nan]), np.array([0.0, 0.05, 0.1]), 0.05)
    assert values == pytest.approx([1.0, 0.5, 0.0])


def test_depth_contrast_tells_relief_from_planes_and_from_noise(
    rng: np.random.Generator,
) -> None:
    u, v = np.meshgrid(np.arange(200.0), np.arange(60.0))
    depth = 2.0 + 0.004 * u + 0.002 * v  # a slanted plane
    depth[:, 60:120] += 0.05 * np.sin(2.0 * np.pi * u[:, 60:120] / 8.0)
    depth[:, 120:] += rng.normal(0.0, 0.02, (60, 80))
    depth[:, 190:] = np.nan
    sigmas = np.full_like(depth, 0.02).astype(np.float32)
    pixels = np.array([[30.0, 30.0], [90.0, 30.0], [150.0, 30.0], [196.0, 30.0]])
    plane, ripples, noise, nothing = depth_contrast(
        depth.astype(np.float32), sigmas, pixels, (9, 13, 17)
    )
    assert plane < 0.2 * ripples
    assert noise < 0.5 * ripples
    assert nothing == 0.0
    exact = np.full_like(sigmas, 1e-5)
    one = depth_contrast(depth.astype(np.float32), exact, pixels[1:2], (17,))
    assert one == pytest.approx([17.0 / 8.0], rel=0.25)  # frequency times window
    with pytest.raises(InvalidInputError, match="windows"):
        depth_contrast(depth.astype(np.float32), sigmas, pixels, (13, 9))


def test_penalty_falls_with_the_distance_to_the_nearest() -> None:
    pixels = np.array([[0.0, 0.0], [30.0, 40.0], [500.0, 0.0]])
    values = spread_penalty(pixels, np.array([[0.0, 0.0], [1000.0, 0.0]]), 50.0)
    assert values == pytest.approx([1.0, np.exp(-1.0), 0.0], abs=1e-6)
    assert spread_penalty(pixels, np.zeros((0, 2)), 50.0).tolist() == [0.0, 0.0, 0.0]


def test_corner_strength_is_the_smaller_eigenvalue_of_the_mean_gradient_product(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plane = TexturedPlane(seed=3)
    image = plane.expose(plane.light(START))
    sobel = [cv2.Sobel(image, cv2.CV_64F, *order) / 8.0 for order in ((1, 0), (0, 1))]
    config = FiducialSelectionConfig()
    monkeypatch.setattr(selection, "_MIN_CORNER", 0.0)
    pixels = corner_candidates(image, np.zeros((0, 2)), config)
    strengths = []
    for u, v in pixels.astype(int):
        window = [g[v - 3 : v + 4, u - 3 : u + 4].ravel() for g in sobel]
        product = np.array([[np.mean(a * b) for a in window] for b in window])
        strengths.append(np.sqrt(np.linalg.eigvalsh(product)[0]))
    limit = float(np.median(strengths))
    monkeypatch.setattr(selection, "_MIN_CORNER", limit)
    kept = corner_candidates(image, np.zeros((0, 2)), config)
    expected = {tuple(p) for p, s in zip(pixels, strengths, strict=True) if s > 1.01 * limit}
    refused = {tuple(p) for p, s in zip(pixels, strengths, strict=True) if s < 0.99 * limit}
    assert expected <= {tuple(p) for p in kept}
    assert not refused & {tuple(p) for p in kept}


def test_chosen_ones_keep_their_distance_from_each_other_and_from_those_there(
    view: StereoView,
) -> None:
    first = select_fiducials(view, [], 20)
    second = select_fiducials(view, first, 20)
    assert len(first) == len(second) == 20
    assert distances(np.concatenate([first, second])).min() >= selection.MIN_DISTANCE - 1.0
    border = np.concatenate([first, second])
    assert border.min() >= selection.BORDER
    assert (border < [320 - selection.BORDER, 240 - selection.BORDER]).all()
    assert np.isfinite(view.inverse_depths(first)[0]).all()


def test_the_penalty_spreads_them(view: StereoView, monkeypatch: pytest.MonkeyPatch) -> None:
    spread = select_fiducials(view, [], 12)
    monkeypatch.setattr(selection, "_SPREAD_WEIGHT", 0.0)
    loose = select_fiducials(view, [], 12)
    nearest = [np.sort(distances(p))[:6].mean() for p in (loose, spread)]
    assert nearest[1] > 1.3 * nearest[0]


def test_fewer_are_chosen_where_there_is_little_to_see() -> None:
    flat = np.full((240, 320), 128, np.uint8)
    assert len(select_fiducials(StereoView(0, flat, flat, SENSOR), [], 10)) == 0
    plane = TexturedPlane()
    image = plane.expose(plane.light(START))
    alone = StereoView(0, image, flat, SENSOR)  # texture without range
    assert len(select_fiducials(alone, [], 10)) == 0
    assert len(select_fiducials(plane.view(START), [], 10)) == 10


def test_a_certain_part_of_the_map_is_preferred(view: StereoView) -> None:
    """Only what lies to the left was seen before."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05, max_range=10.0))
    points = view.cloud().organized_points.copy()
    points[:, 160:] = np.nan
    for _ in range(6):
        voxel_map.integrate(points, START, camera=view.camera)
    weights = FiducialSelectionConfig(certainty_weight=50.0)
    known = select_fiducials(view, [], 20, voxel_map, START, weights)
    assert (known[:, 0] < 165).mean() > 0.8
    with pytest.raises(InvalidInputError, match="T_map_camera"):
        select_fiducials(view, [], 20, voxel_map)


def test_dense_range_is_only_asked_for_when_wanted() -> None:
    plane = TexturedPlane()
    sparse = plane.view(START)
    select_fiducials(sparse, [], 5)
    assert not sparse.has_cloud
    select_fiducials(sparse, [], 5, config=FiducialSelectionConfig(dense_range=True))
    assert sparse.has_cloud
