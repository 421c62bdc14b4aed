"""The strategies, each by what it is meant to prefer."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from infomap_ros.errors import ConfigError
from infomap_ros.mapping.voxels.keys import pack
from infomap_ros.views.ranking.look_ahead import LookAhead, LookAheadConfig
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Rating, RatingConfig, Ratings
from infomap_ros.views.ranking.strategies import make_strategy, strategies
from infomap_ros.views.ranking.strategy import Scores, Strategy
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import RegionOfTask, Situation

from .choices import Prescribed, options_of
from .rooms import CAMERA, facing, seen_room, turning

ROOM = (6.0, 4.0, 2.5)
START = (1.5, 2.0, 1.2)


@pytest.fixture(scope="module")
def half_seen() -> Situation:
    """A room of which the camera has seen what lies ahead (+x)."""
    poses = [facing(angle, START) for angle in (-0.5, 0.0, 0.5)]
    region = RegionOfTask((0, 0, 0), ROOM)
    return Situation(seen_room(poses, ROOM), CAMERA, 4.0, poses[1], region=region)


def score(strategy: Strategy, options: Options) -> Scores:
    return strategy.score(options, Rating().rate(options))


def test_all_strategies_of_the_paper_are_there() -> None:
    names = {"random", "raster", "largest_unknown", "smallest_known", "largest_information"}
    assert set(strategies()) == names | {"look_ahead"}
    for name in strategies():
        assert callable(make_strategy(name).score)


def test_largest_information_is_the_rating(half_seen: Situation) -> None:
    options = options_of(half_seen, [facing(a, START) for a in (0.0, 2.0, 3.0)], [5.0, 70.0, 60.0])
    ratings = Rating().rate(options)
    values = make_strategy("largest_information").score(options, ratings).values
    np.testing.assert_array_equal(values, ratings.ratings)


def test_random_is_uniform_and_keeps_its_goal(half_seen: Situation) -> None:
    options = options_of(half_seen, [facing(a, START) for a in (0.0, 2.0, 3.0)], [0.0, 9.0, 0.0])
    winners = [score(make_strategy("random"), options).values.argmax() for _ in range(600)]
    counts = np.bincount(winners, minlength=3)
    assert counts.min() > 150
    kept = options_of(half_seen, options.poses, [0.0, 9.0, 0.0], previous=2)
    assert score(make_strategy("random"), kept).values.argmax() == 2


def test_largest_unknown_counts_unknown_volume_alone(half_seen: Situation) -> None:
    ahead, behind = facing(0.0, (1.55, 2.05, 1.25)), facing(np.pi, (3.0, 2.0, 1.2))
    options = options_of(half_seen, [ahead, behind], [90.0, 1.0])
    assert score(make_strategy("largest_unknown"), options).values.argmax() == 1


def test_smallest_known_prefers_views_without_known_space(half_seen: Situation) -> None:
    mixed, unknown = facing(1.2, START), facing(np.pi, (2.6, 2.0, 1.2))
    wall = facing(0.0, (5.7, 2.0, 1.2))
    options = options_of(half_seen, [mixed, unknown, wall], [9.0, 1.0, 5.0])
    values = score(make_strategy("smallest_known"), options).values
    assert values.argmax() == 1
    assert values[2] < values[0]  # a near wall shows nothing known, and nothing at all


def test_raster_goes_row_by_row_there_and_back(half_seen: Situation) -> None:
    region = RegionOfTask((0.0, 0.0, 0.0), (4.8, 4.8, 2.5))  # cells of 1.6 m
    now = Situation(half_seen.voxel_map, CAMERA, 4.0, half_seen.T_map_camera, region=region)
    places = [(x, y, 1.0) for y in (0.8, 2.4, 4.0) for x in (0.8, 2.4, 4.0)]
    poses = [facing(0.1, place) for place in places]
    visited: list[int] = []
    while len(visited) < len(poses):
        past = np.array([poses[i] for i in visited]).reshape(-1, 4, 4)
        seen = Situation(**{**now.__dict__, "past_views": past})
        options = options_of(seen, poses, [1.0] * len(poses))
        visited.append(int(score(make_strategy("raster"), options).values.argmax()))
    forth, back = [0, 1, 2, 5, 4, 3, 6, 7, 8], [2, 1, 0, 3, 4, 5, 8, 7, 6]
    assert visited in (forth, back)


def test_raster_looks_all_around_before_it_goes_on(half_seen: Situation) -> None:
    places = [(0.8, 0.8, 1.0), (2.4, 0.8, 1.0)]
    turns = [facing(angle, place) for place in places for angle in (-2.5, -1.0, 0.5, 2.0)]
    visited: list[int] = []
    while len(visited) < len(turns):
        past = np.array([turns[i] for i in visited]).reshape(-1, 4, 4)
        seen = Situation(**{**half_seen.__dict__, "past_views": past})
        options = options_of(seen, turns, [1.0] * len(turns))
        visited.append(int(score(make_strategy("raster"), options).values.argmax()))
    where = [i // 4 for i in visited]
    assert where in ([0] * 4 + [1] * 4, [1] * 4 + [0] * 4)


class Own:
    """A user's strategy."""

    requires_positive_utility = False

    def score(self, options: Options, ratings: Ratings) -> Scores:
        return Scores(-options.positions[:, 0])


class Incomplete:
    """Lacks what a strategy must have."""


def test_own_strategy_by_its_path(half_seen: Situation) -> None:
    strategy = make_strategy(f"{__name__}.Own")
    options = options_of(half_seen, [facing(0, (x, 2, 1.2)) for x in (2, 1, 3)], [1, 2, 3])
    assert score(strategy, options).values.argmax() == 1


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("best", "look_ahead"),
        ("no_such_package.Strategy", "no_such_package"),
        ("infomap_ros.views.ranking.strategies.Missing", "Missing"),
        (f"{__name__}.Incomplete", "score"),
        ("infomap_ros.views.sampling.surroundings.Surroundings", "without arguments"),
    ],
)
def test_unusable_strategies_are_refused(name: str, message: str) -> None:
    assert Surroundings is not None
    with pytest.raises(ConfigError, match="strategy") as caught:
        make_strategy(name)
    assert message in str(caught.value)


# Look-ahead: views by camera position x, each informing named voxels.


def voxels(count: int, first: int = 0) -> dict[int, float]:
    return {int(pack(0, 0, first + i)): 1.0 for i in range(count)}


@pytest.fixture(scope="module")
def seen() -> Situation:
    poses = [*turning(START, 8), *turning((4.5, 2.0, 1.2), 8)]
    return Situation(seen_room(poses, ROOM), CAMERA, 4.0, poses[0])


def ahead(
    now: Situation, gains: dict[float, dict[int, float]], config: LookAheadConfig
) -> tuple[Options, Ratings, Scores]:
    poses = [facing(0.0, (x, 2.0, 1.2)) for x in gains]
    source = Prescribed(gains)
    information = [sum(of.values()) for of in gains.values()]
    options = options_of(now, poses, information, full=100.0, source=source)
    ratings = Rating(RatingConfig(localization_weight=0.0, distance_weight=0.02)).rate(options)
    return options, ratings, LookAhead(config).score(options, ratings)


def worth(
    config: LookAheadConfig,
    options: Options,
    ratings: Ratings,
    gains: list[dict[int, float]],
    order: tuple[int, ...],
) -> float:
    """The definition, voxel by voxel."""
    told: dict[int, float] = {}
    total, distance, here = 0.0, 0.0, options.situation.position
    for turn, view in enumerate(order):
        news = sum(max(0.0, gain - told.get(key, 0.0)) for key, gain in gains[view].items())
        for key, gain in gains[view].items():
            told[key] = max(gain, told.get(key, 0.0))
        step = float(np.linalg.norm(options.positions[view] - here))
        if turn == 0:
            step = float(ratings.terms["distance"][view])
        rating = (news / 100.0 - 0.02 * step) * (1.0 - ratings.terms["risk"][view])
        distance += step + config.cost_of_view
        total += rating * (math.exp(-distance / config.discount_distance) if rating > 0.0 else 1.0)
        here = options.positions[view]
    return total


@pytest.mark.parametrize("depth", [3, 4])
def test_look_ahead_finds_the_best_sequence_of_all(
    seen: Situation, rng: np.random.Generator, depth: int
) -> None:
    config = LookAheadConfig(depth=depth, views=6, beam=1000, unlike_distance=0.0)
    for _ in range(4):
        places = np.sort(rng.uniform(1.0, 4.8, 6)).round(3)
        gains = {float(x): {**voxels(40, int(rng.integers(60)))} for x in places}
        options, ratings, scores = ahead(seen, gains, config)
        expected = np.full(6, -np.inf)
        for length in range(1, depth + 1):
            for order in itertools.permutations(range(6), length):
                value = worth(config, options, ratings, list(gains.values()), order)
                expected[order[0]] = max(expected[order[0]], value)
        best = int(expected.argmax())
        assert scores.values.argmax() == best
        assert scores.values[best] == pytest.approx(expected[best], rel=0.1)


def test_look_ahead_goes_on_with_its_plan(seen: Situation) -> None:
    poses = [facing(0.0, (x, 2.0, 1.2)) for x in (2.5, 4.5)]
    source = Prescribed({2.5: voxels(25), 4.5: voxels(60, 100)})
    strategy = LookAhead(LookAheadConfig(depth=2, discount_distance=4.0))
    options = options_of(seen, poses, [25.0, 60.0], full=100.0, source=source)
    surroundings, rng = options.surroundings, options.rng
    assert not len(strategy.propose(seen, surroundings, rng))
    score(strategy, options)
    np.testing.assert_array_equal(strategy.propose(seen, surroundings, rng), poses[1:])


def test_small_gain_on_the_way_is_taken_first(seen: Situation) -> None:
    gains = {2.5: voxels(25), 4.5: voxels(60, 100)}
    _, ratings, scores = ahead(seen, gains, LookAheadConfig(depth=2, discount_distance=4.0))
    assert ratings.ratings.argmax() == 1  # one view ahead, the large gain comes first
    assert scores.values.argmax() == 0
    assert scores.plans[0] == (1,)


def test_gain_that_the_large_view_brings_anyway_is_not(seen: Situation) -> None:
    gains = {2.5: voxels(25, 110), 4.5: voxels(60, 100)}
    _, _, scores = ahead(seen, gains, LookAheadConfig(depth=2, cost_of_view=3.0))
    assert scores.values.argmax() == 1


def test_first_ranking_keeps_unlike_views(seen: Situation) -> None:
    poses = [facing(a, (2.0, 2.0, 1.2)) for a in (0.0, 0.1, -0.1, 2.0)]
    options = options_of(seen, poses, [90.0, 80.0, 70.0, 10.0], fine=False)
    order = np.argsort(-score(LookAhead(), options).values)
    np.testing.assert_array_equal(order, [0, 3, 1, 2])
