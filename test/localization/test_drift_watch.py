"""Fiducials that move slowly, told from those that stand still."""

from __future__ import annotations

import numpy as np

from infomap_ros.localization.filter.history import DriftWatch


def watched(bias: float, images: int, rng: np.random.Generator, count: int = 400) -> np.ndarray:
    """Whether fiducials are found to move whose innovations have a bias."""
    watch = DriftWatch(0.9, 0.999)
    ids = np.arange(count)
    for _ in range(images):
        innovations = rng.normal(size=(count, 3))
        innovations[:, 0] += bias
        watch.add(ids, innovations)
    return watch.is_drifting(ids)


def test_those_that_stand_still_are_found_as_rarely_as_the_gate_says() -> None:
    found = np.mean([watched(0.0, 30, np.random.default_rng(seed)).mean() for seed in range(10)])
    assert 0.0002 < found < 0.002


def test_slow_motion_is_found_though_each_innovation_is_small() -> None:
    """A bias of 1.5 sigma lies within any gate for a single image."""
    rng = np.random.default_rng(1)
    assert watched(1.5, 1, rng).mean() < 0.05
    assert watched(1.5, 12, rng).mean() > 0.5


def test_a_sum_forgets() -> None:
    watch = DriftWatch(0.5, 0.999)
    one = np.array([7])
    watch.add(one, np.array([[8.0, 0.0, 0.0]]))
    assert watch.is_drifting(one)[0]
    for _ in range(6):
        watch.add(one, np.zeros((1, 3)))
    assert not watch.is_drifting(one)[0]


def test_those_forgotten_or_never_seen_do_not_move() -> None:
    watch = DriftWatch(0.9, 0.999)
    watch.add(np.array([1, 2]), np.full((2, 3), 9.0))
    watch.forget(np.array([1]))
    assert watch.is_drifting(np.array([1, 2, 3])).tolist() == [False, True, False]
