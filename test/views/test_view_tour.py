"""Tours of views, against all orders and by what they are meant to prefer."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from infomap_ros.mapping.voxels.keys import pack
from infomap_ros.views.ranking import tour_kernels
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Rating, RatingConfig
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.ranking.view_tour import ViewTour, ViewTourConfig
from infomap_ros.views.situation import Situation

from .choices import Prescribed, options_of
from .rooms import CAMERA, facing, seen_room, turning


@pytest.fixture(scope="module")
def seen() -> Situation:
    poses = [*turning((1.5, 2.0, 1.2), 8), *turning((4.5, 2.0, 1.2), 8)]
    return Situation(seen_room(poses, (6.0, 4.0, 2.5)), CAMERA, 4.0, poses[0])


def voxels(count: int, first: int) -> dict[int, float]:
    return {int(pack(0, 0, first + i)): 1.0 for i in range(count)}


def ranked(now: Situation, gains: dict[float, dict[int, float]], config: ViewTourConfig) -> Scores:
    """Scores of views that stand at x on a line through the room, by the voxels they inform."""
    poses = [facing(0.0, (x, 2.0, 1.2)) for x in gains]
    information = [sum(of.values()) for of in gains.values()]
    source = Prescribed(gains)
    options: Options = options_of(now, poses, information, full=100.0, source=source)
    rating = Rating(RatingConfig(localization_weight=0.0, distance_weight=0.02))
    return ViewTour(config).score(options, rating.rate(options))


def worth(order: tuple[int, ...], problem: tuple[np.ndarray, ...]) -> float:
    """The definition, in floating-point numbers of Python."""
    first, between, prizes, (discount_distance, weight, view) = problem
    total, way, here = 0.0, 0.0, -1
    for place in order:
        way += (first[place] if here < 0 else between[here, place]) + view
        total += prizes[place] * math.exp(-way / discount_distance)
        here = place
    return total - weight * way


def random_problem(rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    places = rng.uniform(0.0, 100.0, (count, 2))
    between = np.linalg.norm(places[:, None] - places, axis=2)
    first = np.linalg.norm(places - 50.0, axis=1)
    return first, between, rng.uniform(0.5, 3.0, count), np.array([90.0, 0.01, 1.0])


def test_worth_is_that_of_the_definition(rng: np.random.Generator) -> None:
    problem = random_problem(rng, 6)
    for length in (1, 3, 6):
        order = rng.permutation(6)
        found = tour_kernels.tour_utility(order, length, *problem)
        assert found == pytest.approx(worth(tuple(order[:length]), problem))


def test_tours_are_nearly_the_best_of_all(rng: np.random.Generator) -> None:
    shares = []
    for _ in range(15):
        problem = random_problem(rng, 6)
        order = np.zeros(6, np.int64)
        count = tour_kernels.build_tour(order, 0, 0, *problem)
        found = tour_kernels.improve_tour(order, count, 0, *problem)
        assert found == pytest.approx(worth(tuple(order[:count]), problem))
        assert len(set(order[:count])) == count
        every = (p for n in range(1, 7) for p in itertools.permutations(range(6), n))
        shares.append(found / max(worth(p, problem) for p in every))
    assert max(shares) == pytest.approx(1.0)
    assert np.mean(shares) > 0.97


def test_fixed_beginnings_stay(rng: np.random.Generator) -> None:
    problem = random_problem(rng, 8)
    order = np.zeros(8, np.int64)
    order[:2] = 5, 3
    count = tour_kernels.build_tour(order, 2, 2, *problem)
    tour_kernels.improve_tour(order, count, 2, *problem)
    assert list(order[:2]) == [5, 3]
    assert len(set(order[:count])) == count > 2


def test_kernels_mean_the_same_uncompiled(rng: np.random.Generator) -> None:
    problem = random_problem(rng, 4)
    plain, compiled = np.zeros(4, np.int64), np.zeros(4, np.int64)
    counts = [
        build(order, 0, 0, *problem)
        for build, order in (
            (tour_kernels.build_tour.py_func, plain),
            (tour_kernels.build_tour, compiled),
        )
    ]
    values = [
        improve(order, counts[0], 0, *problem)
        for improve, order in (
            (tour_kernels.improve_tour.py_func, plain),
            (tour_kernels.improve_tour, compiled),
        )
    ]
    assert counts[0] == counts[1]
    np.testing.assert_array_equal(plain, compiled)
    assert values[0] == pytest.approx(values[1])


def test_small_gain_on_the_way_is_taken_first(seen: Situation) -> None:
    gains = {2.5: voxels(20, 0), 4.5: voxels(60, 100)}
    scores = ranked(seen, gains, ViewTourConfig(discount_distance=20.0, cost_of_view=0.1))
    assert scores.values.argmax() == 0
    assert scores.plans[0] == (1,)


def test_what_another_view_tells_anyway_is_no_part_of_a_tour(seen: Situation) -> None:
    gains = {2.5: voxels(20, 100), 4.5: voxels(60, 100)}
    scores = ranked(seen, gains, ViewTourConfig(discount_distance=20.0, cost_of_view=0.1))
    assert scores.values.argmax() == 1
    assert scores.plans[1] == ()


def test_first_ranking_is_that_of_the_look_ahead(seen: Situation) -> None:
    poses = [facing(a, (2.0, 2.0, 1.2)) for a in (0.0, 0.1, -0.1, 2.0)]
    options = options_of(seen, poses, [90.0, 80.0, 70.0, 10.0], fine=False)
    values = ViewTour().score(options, Rating().rate(options)).values
    np.testing.assert_array_equal(np.argsort(-values), [0, 3, 1, 2])
