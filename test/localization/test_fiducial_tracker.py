from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.localization.fiducials.patch_alignment import (
    MARGIN,
    align_templates,
    cut_templates,
)
from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.localization.fiducials.selection import select_fiducials
from infomap_ros.localization.fiducials.tracker import FiducialTracker
from test.localization.textured_plane import SENSOR, TexturedPlane, camera_at

START = camera_at([0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def plane() -> TexturedPlane:
    return TexturedPlane()


def chosen(plane: TexturedPlane, count: int = 40) -> tuple[FiducialTracker, np.ndarray]:
    """A tracker that follows fiducials chosen from START, and their pixels."""
    view = plane.view(START)
    pixels = select_fiducials(view, [], count)
    tracker = FiducialTracker()
    added = tracker.add(view, np.arange(len(pixels)), pixels)
    assert len(added) == len(pixels)
    return tracker, pixels


def trajectory(steps: int) -> list[np.ndarray]:
    return [
        camera_at([0.012 * k, 0.004 * k, 0.02 * k], [0.004 * k, -0.006 * k, 0.005 * k])
        for k in range(1, steps + 1)
    ]


def test_pixels_stay_on_their_points_within_the_stated_sigma(plane: TexturedPlane) -> None:
    tracker, pixels = chosen(plane)
    errors, sigmas, ranges = [], [], []
    for k, pose in enumerate(trajectory(12)):
        seen = tracker.track(plane.view(pose, k + 1))
        expected = plane.moved(START, pose, pixels[seen.ids])
        errors.append(seen.pixels - expected)
        sigmas.append(seen.pixel_sigmas)
        true = plane.inverse_depths(pose, seen.pixels)
        ranges.append((seen.inverse_depths - true) / seen.inverse_depth_sigmas)
        assert len(seen) > 0.7 * len(pixels)
    last = np.linalg.norm(errors[-1], axis=1)
    assert np.quantile(last, 0.68) < 0.1  # it does not creep
    normalized = np.concatenate(errors) / np.concatenate(sigmas)[:, None]
    assert (np.abs(normalized) < 1.0).mean() > 0.68
    assert (np.abs(normalized) < 2.0).mean() > 0.95
    found = np.concatenate(ranges)
    assert (np.abs(found[np.isfinite(found)]) < 2.0).mean() > 0.95


@pytest.mark.parametrize(("gain", "offset"), [(0.5, 20.0), (1.3, -20.0), (0.7, 60.0)])
def test_a_step_of_the_light_does_not_matter(
    plane: TexturedPlane, gain: float, offset: float
) -> None:
    tracker, pixels = chosen(plane)
    pose = trajectory(1)[0]
    seen = tracker.track(plane.view(pose, 1, gain, offset))
    error = np.linalg.norm(seen.pixels - plane.moved(START, pose, pixels[seen.ids]), axis=1)
    assert len(seen) > 0.85 * len(pixels)
    assert np.quantile(error, 0.9) < 0.2


def test_tracks_outlive_blurred_images(plane: TexturedPlane) -> None:
    tracker, pixels = chosen(plane)
    first, second, third = trajectory(3)
    blurred = tracker.track(plane.view(first, 1, blur=2.5))
    again = tracker.track(plane.view(second, 2, blur=2.5))
    seen = tracker.track(plane.view(third, 3))
    assert len(blurred) > 0.6 * len(pixels)
    assert len(seen) > 0.8 * len(pixels)
    for pose, some in ((second, again), (third, seen)):
        error = np.linalg.norm(some.pixels - plane.moved(START, pose, pixels[some.ids]), axis=1)
        assert np.quantile(error, 0.68) < 0.4


def test_a_prediction_bridges_a_step_that_flow_cannot(plane: TexturedPlane) -> None:
    pose = camera_at([0.05, 0.0, 0.1], [0.0, 0.35, 0.0])
    tracker, pixels = chosen(plane)
    expected = plane.moved(START, pose, pixels)
    inside = ((expected > 15) & (expected < [304, 224])).all(axis=1)
    predicted = {k: expected[k] + [2.5, -2.0] for k in range(len(pixels))}
    seen = tracker.track(plane.view(pose, 1), predicted)
    assert len(seen) > 0.7 * inside.sum()
    assert np.quantile(np.linalg.norm(seen.pixels - expected[seen.ids], axis=1), 0.9) < 0.3


def test_descriptors_bridge_a_large_step_without_prediction(plane: TexturedPlane) -> None:
    pose = camera_at([0.05, 0.0, 0.1], [0.0, 0.35, 0.0])
    tracker, pixels = chosen(plane)
    seen = tracker.track(plane.view(pose, 1))
    error = np.linalg.norm(seen.pixels - plane.moved(START, pose, pixels[seen.ids]), axis=1)
    assert len(seen) >= 6
    assert (error < 1.0).mean() > 0.8


def test_a_fiducial_that_is_covered_is_not_seen_and_then_given_up(plane: TexturedPlane) -> None:
    tracker, pixels = chosen(plane)
    hidden = np.flatnonzero(pixels[:, 0] < 160)
    rng = np.random.default_rng(4)
    for k, pose in enumerate(trajectory(7)):
        view = plane.view(pose, k)
        image = view.image.copy()
        image[:, :190] = rng.integers(60, 180, (240, 190))
        seen = tracker.track(StereoView(k, image, image, SENSOR))
        assert not np.isin(seen.ids, hidden).any()
    assert not np.isin(tracker.ids, hidden).any()


def test_dormant_fiducials_are_recalled_on_their_old_points(plane: TexturedPlane) -> None:
    tracker, pixels = chosen(plane)
    tracker.set_aside(np.arange(len(pixels)))
    assert len(tracker.ids) == 0
    pose = camera_at([0.05, -0.03, 0.3], [0.02, 0.05, 0.06])
    view = plane.view(pose, 1)
    assert len(tracker.track(view)) == 0
    expected = plane.moved(START, pose, pixels)
    predicted = {k: expected[k] + [4.0, -3.0] for k in range(10, len(pixels))}
    near = tracker.recall(view, predicted, 8.0)
    assert set(near.ids.tolist()) <= set(predicted)
    assert len(near) > 0.6 * len(predicted)
    anywhere = tracker.recall(view)
    for found in (near, anywhere):
        error = np.linalg.norm(found.pixels - expected[found.ids], axis=1)
        assert (error < 0.5).all()
    assert set(tracker.ids.tolist()) == set(near.ids.tolist()) | set(anywhere.ids.tolist())
    assert len(tracker.track(plane.view(pose, 2))) > 0.9 * len(tracker.ids)


@pytest.mark.parametrize("roll", [0.6, -1.7, np.pi])
@pytest.mark.parametrize("radius", [8.0, 30.0])  # by template, and by descriptor
def test_a_rolled_camera_recalls_what_it_saw_upright(
    plane: TexturedPlane, roll: float, radius: float
) -> None:
    pose = camera_at([0.02, -0.03, 0.1], [0.0, 0.0, roll])
    view = plane.view(pose, 1)
    found = []
    for turn in (-roll, 0.0):
        tracker, pixels = chosen(plane)
        tracker.set_aside(np.arange(len(pixels)))
        expected = plane.moved(START, pose, pixels)
        inside = ((expected > 15) & (expected < [304, 224])).all(axis=1)
        predicted = {k: expected[k] + [4.0, -3.0] for k in np.flatnonzero(inside).tolist()}
        seen = tracker.recall(view, predicted, radius, dict.fromkeys(predicted, turn))
        error = np.linalg.norm(seen.pixels - expected[seen.ids], axis=1)
        assert (error < 0.5).all()
        found.append(len(seen) / len(predicted))
    assert found[0] > 0.6
    assert found[1] < 0.5 * found[0]


def test_a_fiducial_is_recalled_by_how_it_looked_last(plane: TexturedPlane) -> None:
    """Chosen upright, last seen by a camera that had rolled slowly, and looked for from there."""
    tracker, pixels = chosen(plane)
    for k in range(1, 11):
        last = camera_at([0.0, 0.0, 0.0], [0.0, 0.0, 0.15 * k])
        seen = tracker.track(plane.view(last, k))
    assert len(seen) > 0.3 * len(pixels)
    tracker.set_aside(seen.ids)
    tracker.remove(tracker.ids)
    expected = plane.moved(START, last, pixels)
    predicted = {k: expected[k] for k in seen.ids.tolist()}
    for radius in (8.0, 30.0):
        again = tracker.recall(plane.view(last, 20), predicted, radius)
        assert len(again) > 0.7 * len(seen)
        tracker.set_aside(again.ids)


def test_a_restored_tracker_recalls_what_the_saved_one_knew(plane: TexturedPlane) -> None:
    tracker, pixels = chosen(plane)
    tracker.set_aside([0, 1])
    restored = FiducialTracker.from_state(tracker.state())
    view = plane.view(START, 1)
    predicted = {k: pixels[k] for k in range(len(pixels))}
    found = restored.recall(view, predicted, 3.0)
    assert len(found) > 0.9 * len(pixels)
    assert np.allclose(found.pixels, pixels[found.ids], atol=0.3)
    with pytest.raises(InvalidInputError, match="templates"):
        FiducialTracker.from_state(tracker.state() | {"templates": np.zeros((len(pixels), 29, 29))})
    with pytest.raises(InvalidInputError, match="warps"):
        FiducialTracker.from_state({k: v for k, v in tracker.state().items() if k != "warps"})


def test_removed_fiducials_are_neither_followed_nor_recalled(plane: TexturedPlane) -> None:
    tracker, pixels = chosen(plane)
    tracker.set_aside([3])
    tracker.remove([2, 3, 77])
    assert not np.isin([2, 3], tracker.ids).any()
    view = plane.view(START, 1)
    assert not np.isin([2, 3], tracker.track(view).ids).any()
    assert len(tracker.recall(view, {2: pixels[2], 3: pixels[3]}, 5.0)) == 0


def test_what_cannot_be_followed_is_refused_or_left_out(plane: TexturedPlane) -> None:
    tracker, pixels = chosen(plane)
    view = plane.view(START)
    for ids, places in (
        ([0], [[50, 50]]),
        ([90, 90], [[50, 50], [60, 60]]),
        ([90], [[1, 2], [3, 4]]),
    ):
        with pytest.raises(InvalidInputError, match="ids"):
            tracker.add(view, ids, places)
    with pytest.raises(InvalidInputError, match="radius"):
        tracker.recall(view, {1: pixels[1]})
    assert len(tracker.add(view, [91, 92], [[2.0, 100.0], [100.0, 100.0]])) == 1
    assert 91 not in tracker.ids


def test_alignment_recovers_a_known_warp_and_its_sigma_is_that_of_noise(
    plane: TexturedPlane,
) -> None:
    light = plane.light(START)
    image = plane.expose(light, 0.0)
    pixels = np.array([[u, v] for u in range(50, 280, 25) for v in range(50, 200, 25)], float)
    warp = np.array([[1.1, 0.08], [-0.06, 0.95]])
    shifted = pixels + np.array([0.3, -0.4])
    templates, inside = cut_templates(image, shifted, np.tile(warp, (len(pixels), 1, 1)), 15)
    assert inside.all()
    assert templates.shape == (len(pixels), 15 + 2 * MARGIN, 15 + 2 * MARGIN)
    errors, stated = [], []
    for _ in range(12):
        noisy = plane.expose(0.8 * light + 10.0, 4.0)
        start = np.tile(np.eye(2), (len(pixels), 1, 1))
        aligned = align_templates(noisy, templates, pixels, start, np.zeros(len(pixels), np.int64))
        errors.append(aligned.pixels - shifted)
        stated.append(aligned.sigmas)
    errors, stated = np.array(errors), np.array(stated)
    good = np.isfinite(errors).all(axis=(0, 2)) & (np.nanmax(stated, axis=0) < 0.15)
    assert good.mean() > 0.7
    assert np.abs(errors[:, good].mean(axis=0)).max() < 0.15
    ratio = errors[:, good].std(axis=0).max(axis=1) / stated[:, good].mean(axis=0)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.3)


def test_flow_alone_would_creep_where_templates_do_not(plane: TexturedPlane) -> None:
    """The sum of the steps between images wanders, the pixels do not: their steps cancel."""
    tracker, _ = chosen(plane)
    there_and_back = trajectory(4) + trajectory(3)[::-1] + [START]
    places = [dict(zip(tracker.ids.tolist(), tracker.pixels, strict=True))]
    for k, pose in enumerate(there_and_back):
        seen = tracker.track(plane.view(pose, k + 1))
        places.append(dict(zip(seen.ids.tolist(), seen.pixels, strict=True)))
    assert all(before.keys() & after.keys() for before, after in pairwise(places))
    both = places[0].keys() & places[-1].keys()
    back = np.array([places[-1][k] - places[0][k] for k in both])
    assert len(both) > 20
    assert np.quantile(np.linalg.norm(back, axis=1), 0.68) < 0.05
