"""A pair of cameras that is out of order is named within 20 pairs, and a sound one never is."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest

from infomap_ros.errors import SensorFaultError
from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.geometry.resources import find_share
from infomap_ros.pipeline import range_estimator
from infomap_ros.pipeline.image_synchronizer import ImageSynchronizer
from infomap_ros.pipeline.range_estimator import PairRectifier, StereoHealth
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.stereo import StereoConfig

Pair = tuple[np.ndarray, np.ndarray]
Fault = Callable[[int, list[Pair]], Pair]
CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)
RIG = StereoRig(CAMERA, CAMERA, 0.1)
DISPARITY = 24
TOPICS = ("/left/image_raw", "/right/image_raw", "/left/camera_info", "/right/camera_info")


def panned(count: int) -> list[Pair]:
    """A camera pans and nods before a wall, not steadily; each image has noise of its own."""
    rng = np.random.default_rng(1)
    wall = rng.integers(0, 256, (900, 1800)).astype(np.float32)
    wall = 128.0 + 4.0 * (cv2.GaussianBlur(wall, (0, 0), 3.0) - 128.0)
    pairs = []
    for k in range(count):
        x, y = int(400 + 12 * np.sin(1.3 * k)), int(200 + 3 * np.sin(0.9 * k))
        views = wall[y : y + 480, x : x + 640], wall[y : y + 480, x + DISPARITY :][:, :640]
        noisy = [np.clip(view + rng.normal(0.0, 1.5, view.shape), 0, 255) for view in views]
        pairs.append((noisy[0].astype(np.uint8), noisy[1].astype(np.uint8)))
    return pairs


PAIRS = panned(60)


def recorded() -> Iterator[tuple[np.ndarray, np.ndarray, StereoRig]]:
    images, rectifier = ImageSynchronizer(2, 2), PairRectifier(StereoConfig(), rectify=True)
    with BagReader(find_share("bags/rover_rocks")) as bag:
        for entry in bag.records(TOPICS):
            number = TOPICS.index(entry.topic)
            add = images.add_image if number < 2 else images.add_info
            for complete in add(number % 2, entry.record):
                left, right, sensor = rectifier.prepare(complete)
                yield left, right, sensor.rig


def alarms(
    pairs: list[Pair], fault: Fault | None = None, span: range = range(0), rig: StereoRig = RIG
) -> list[str]:
    """What is said of each pair, where those of a span have a fault."""
    watched, said = StereoHealth(), []
    for k, pair in enumerate(pairs):
        shown = fault(k, pairs) if fault is not None and k in span else pair
        try:
            watched.check(*shown, rig)
        except SensorFaultError as error:
            said.append(error.fault)
        else:
            said.append("")
    return said


def scaled(pair: Pair, factor: float) -> Pair:
    left, right = ((factor * image).astype(np.uint8) for image in pair)
    return left, right


FAULTS: dict[str, tuple[Fault, str]] = {
    "right = left": (lambda k, p: (p[k][0], p[k][0].copy()), range_estimator.SAME),
    "swapped": (lambda k, p: (p[k][1], p[k][0]), range_estimator.SWAPPED),
    "rows off": (lambda k, p: (p[k][0], np.roll(p[k][1], 2, 0)), range_estimator.ROWS_OFF),
    "rows far off": (lambda k, p: (p[k][0], np.roll(p[k][1], -60, 0)), range_estimator.UNLIKE),
    "right covered": (
        lambda k, p: (p[k][0], p[k][1] // 100),
        range_estimator.COVERED.format("right"),
    ),
    "left covered": (
        lambda k, p: (p[k][0] // 100, p[k][1]),
        range_estimator.COVERED.format("left"),
    ),
    "right frozen": (lambda k, p: (p[k][0], p[20][1]), range_estimator.FROZEN.format("right")),
    "left frozen": (lambda k, p: (p[20][0], p[k][1]), range_estimator.FROZEN.format("left")),
    "flicker": (lambda k, p: scaled(p[k], 0.6 if k % 2 else 1.0), range_estimator.FLICKER),
    "mirrored": (lambda k, p: (p[k][0], p[k][1][:, ::-1].copy()), range_estimator.UNLIKE),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_within_20_pairs_and_forgotten_when_it_is_gone(name: str) -> None:
    fault, named = FAULTS[name]
    said = alarms(PAIRS, fault, range(20, 45))
    assert said[:20] == [""] * 20
    noticed = next(k for k, text in enumerate(said) if text)
    assert noticed < 40 and said[noticed:45] == [named] * (45 - noticed)
    assert said[55:] == [""] * 5


@pytest.mark.parametrize("late", [0, 1])
def test_a_camera_that_is_a_pair_late_is_noticed(late: int) -> None:
    def delayed(k: int, pairs: list[Pair]) -> Pair:
        now, before = pairs[k], pairs[k - 1]
        return (before[0], now[1]) if late == 0 else (now[0], before[1])

    said = alarms(PAIRS, delayed, range(20, 45))
    assert said[:20] == [""] * 20
    noticed = next(k for k, text in enumerate(said) if text)
    assert noticed < 40 and all(said[noticed:45])
    assert (
        range_estimator.LATE.format(("left", "right")[late]) in said
        or range_estimator.ROWS_OFF in said
    )
    assert said[-3:] == [""] * 3


def test_nothing_is_wrong_with_the_shipped_bag_nor_while_nothing_moves() -> None:
    found = list(recorded())  # raises where something is
    assert len(found) == 34
    assert not any(alarms([PAIRS[0]] * 30))  # noise-free and still: as simulated
    flat = np.full((480, 640), 128, np.uint8)
    assert not any(alarms([(flat, flat)] * 10))  # a plain wall


def test_the_noise_of_a_plain_wall_is_nothing_to_match() -> None:
    rng, wall = np.random.default_rng(3), np.full((240, 320), 100.0)
    wall[210:222, 290:302] += 18.0  # all that there is to see
    camera = PinholeCamera(320, 240, 210.0, 210.0, 159.5, 119.5)
    pairs = []
    for _ in range(20):
        noisy = [np.roll(wall, -shift, 1) + rng.normal(0, 1.5, wall.shape) for shift in (0, 8)]
        pairs.append((noisy[0].astype(np.uint8), noisy[1].astype(np.uint8)))
    assert not any(alarms(pairs, rig=StereoRig(camera, camera, 0.1)))


@pytest.mark.parametrize("gain", [0.5, 0.8])
def test_another_exposure_of_one_camera_or_a_light_that_is_switched_is_no_fault(
    gain: float,
) -> None:
    dimmed = [(left, (gain * right).astype(np.uint8)) for left, right in PAIRS[:20]]
    assert not any(alarms(dimmed))
    assert not any(alarms([scaled(pair, gain if k // 10 else 1.0) for k, pair in enumerate(PAIRS)]))
