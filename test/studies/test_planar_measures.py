"""Figures of the planar studies, by hand and against scipy."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from infomap_ros.cli.study_planar import length_ratio, relations
from infomap_ros.studies.baselines.frontier_tour import open_tour, tour_length
from infomap_ros.studies.figure_style import band, curve_band
from infomap_ros.studies.planar.explore import Exploration, ExplorationConfig
from infomap_ros.studies.planar.planar_study import BASELINES, Row, compare, savings_of
from infomap_ros.studies.planar.report import draw_savings
from infomap_ros.studies.planar.tasks import (
    Record,
    Task,
    WorldName,
    area_under_coverage,
    distance_to,
    fraction_at,
    saving,
)

DISTANCE = np.array([0.0, 0.0, 10.0, 30.0])
FRACTION = np.array([0.1, 0.2, 0.5, 0.9])


def test_coverage_is_that_of_the_last_scan_before() -> None:
    at = np.array([0.0, 9.9, 10.0, 29.0, 30.0, 99.0])
    expected = [0.2, 0.2, 0.5, 0.5, 0.9, 0.9]
    np.testing.assert_allclose(fraction_at(DISTANCE, FRACTION, at), expected)


@pytest.mark.parametrize("reach", [5.0, 20.0, 30.0, 100.0])
def test_area_is_the_mean_of_the_curve(reach: float) -> None:
    at = (np.arange(100_000) + 0.5) * reach / 100_000
    mean = fraction_at(DISTANCE, FRACTION, at).mean()
    assert area_under_coverage(DISTANCE, FRACTION, reach) == pytest.approx(mean, abs=1e-4)


def test_distance_to_a_share() -> None:
    assert distance_to(DISTANCE, FRACTION, 0.5) == 10.0
    assert distance_to(DISTANCE, FRACTION, 0.05) == 0.0
    assert distance_to(DISTANCE, FRACTION, 0.95) == np.inf


def test_bands_are_those_of_students_t() -> None:
    values = np.array([3.0, 5.0, 4.0, 8.0])
    low, high = stats.t.interval(0.95, 3, values.mean(), stats.sem(values))
    found = band(values)
    assert (found.mean - found.half, found.mean + found.half) == pytest.approx((low, high))
    mean, half = curve_band(np.column_stack([values, 2.0 * values]))
    np.testing.assert_allclose(mean, [5.0, 10.0])
    np.testing.assert_allclose(half, [found.half, 2.0 * found.half])
    assert np.isnan(band(np.array([1.0])).half)


def row(world: str, strategy: str, distance: float, moved: float, area: float = 0.5) -> Row:
    return Row(world, "rooms", strategy, 10, 0.5, 0.9, area, moved, distance, 0.1, 0.2)


def test_comparison_is_paired_over_worlds() -> None:
    rows = [
        row("a", "own", 80.0, 80.0, 0.6),
        row("a", "other", 100.0, 100.0, 0.5),
        row("b", "own", 300.0, 300.0, 0.4),
        row("b", "other", np.inf, 400.0, 0.1),  # never got so far
        row("c", "own", np.inf, 900.0, 0.2),
        row("c", "other", 500.0, 500.0, 0.3),
        row("d", "own", 10.0, 10.0),  # alone in its world
    ]
    found = compare(rows, "own", "other")
    assert found.saved.mean == pytest.approx((0.2 + 0.25 - 0.8) / 3.0)
    assert (found.saved.count, found.at_least, found.at_most, found.unknown) == (3, 1, 1, 0)
    assert found.area.mean == pytest.approx((0.1 + 0.3 - 0.1) / 3.0)


def test_savings_are_drawn_with_their_bounds(tmp_path: Path) -> None:
    distances = {"a": (80.0, 100.0), "b": (90.0, np.inf), "c": (np.inf, 50.0)}
    rows = [
        row(world, name, distance, min(distance, 95.0))
        for world, both in distances.items()
        for name, distance in zip(("own", "other"), both, strict=True)
    ]
    kinds = [one.kind for one in savings_of(rows, "own", "other")]
    assert kinds == ["exact", "at least", "at most"]
    draw_savings(rows, "own", ["other"], 0.9, tmp_path / "saved")
    text = (tmp_path / "saved.svg").read_text()
    assert "at least" in text and "distance saved by own" in text
    assert (tmp_path / "saved.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("own", "other", "share", "kind"),
    [
        ((80.0, 80.0), (100.0, 100.0), 0.2, "exact"),
        ((80.0, 80.0), (np.inf, 160.0), 0.5, "at least"),
        ((80.0, 80.0), (np.inf, 60.0), np.nan, "unknown"),  # it may have needed 61 m, or 1000 m
        ((np.inf, 150.0), (100.0, 100.0), -0.5, "at most"),
        ((np.inf, 50.0), (100.0, 100.0), 0.0, "at most"),  # to give up early is no merit
        ((np.inf, 50.0), (np.inf, 100.0), np.nan, "unknown"),
    ],
)
def test_distances_that_do_not_arrive_are_bounds(
    own: tuple[float, float], other: tuple[float, float], share: float, kind: str
) -> None:
    found = saving(own, other)
    assert found.kind == kind
    assert found.share == pytest.approx(share, nan_ok=True)


def test_tours_are_nearly_the_shortest() -> None:
    rng = np.random.default_rng(5)
    excess = []
    for _ in range(10):
        places = rng.uniform(0.0, 100.0, (6, 2))
        between = np.linalg.norm(places[:, None] - places, axis=2)
        first = np.linalg.norm(places - 50.0, axis=1)
        found = tour_length(open_tour(first, between), first, between)
        lengths = [
            tour_length(np.array(order), first, between)
            for order in itertools.permutations(range(6))
        ]
        excess.append(found / min(lengths))
    assert min(excess) == pytest.approx(1.0)
    assert max(excess) < 1.1


def record(seed: int, strategy: str, distances: list[float], shares: list[float]) -> Record:
    task = Task(WorldName("caves", seed), strategy, ExplorationConfig(), 10)
    found = Exploration(np.array(shares), np.array(distances), *[np.zeros(1)] * 3, ended="")
    return Record(task, found)


def test_distances_of_baselines_are_compared_where_both_came_so_far() -> None:
    nearest, tour = BASELINES[:2]
    records = [
        record(0, nearest, [0.0, 100.0, 300.0], [0.1, 0.5, 0.9]),
        record(0, tour, [0.0, 50.0, 60.0], [0.1, 0.5, 0.9]),
        record(1, nearest, [0.0, 200.0, 300.0], [0.1, 0.6, 0.9]),
        record(1, tour, [0.0, 400.0, 900.0], [0.1, 0.5, 0.8]),  # ends before
    ]
    half = length_ratio(records, "FrontierTour", "NearestFrontier", 0.5)
    assert (half.mean, half.count) == (pytest.approx(1.0), 2)  # of 1/2 and 2
    last = length_ratio(records, "FrontierTour", "NearestFrontier", 0.9)
    assert (last.mean, last.count) == (pytest.approx(0.2), 1)
    assert (
        length_ratio(records, "FrontierTour", "NearestFrontier", 0.1).count == 0
    )  # by the first view
    line = relations(records, 0.9).splitlines()[2]
    assert line.startswith("| FrontierTour | NearestFrontier | all |")
    assert line.endswith("| 0.20 (1) |")
    assert relations(records[::2], 0.9) == ""
