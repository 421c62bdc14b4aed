"""The cost of eq. (10) in seconds: by hand, in the rating, in the choice and in its reason."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.studies.flight import Flight
from infomap_ros.views.decision import RatedView, why_this
from infomap_ros.views.ranking.look_ahead import LookAhead, LookAheadConfig
from infomap_ros.views.ranking.rating import Cost, Rating, RatingConfig
from infomap_ros.views.ranking.terms import Duration
from infomap_ros.views.situation import MotionTimes, Situation

from .choices import Prescribed, options_of
from .rooms import CAMERA, facing, seen_room, turning

ROOM, START = (6.0, 4.0, 2.5), (1.5, 2.0, 1.2)
TIMES = MotionTimes(speed=0.5, turn_rate=0.8, arm=4.0, arm_rate=0.4, arm_reach=0.5, look=2.0)
SECONDS = RatingConfig(cost="seconds", time_weight=0.004, localization_weight=0.0)


@pytest.fixture(scope="module")
def situation() -> Situation:
    poses = turning(START, 8)
    return Situation(seen_room(poses, ROOM), CAMERA, 4.0, poses[0], times=TIMES)


def seconds(start: np.ndarray, poses: list[np.ndarray], lengths: list[float]) -> np.ndarray:
    return Duration(TIMES).between(start, np.array(poses), np.array(lengths))


def test_a_drive_takes_the_time_of_path_turn_arm_and_look() -> None:
    start = facing(0.0, START)
    there = facing(1.2, (3.5, 2.0, 1.2))
    by_hand = 3.0 / 0.5 + 1.2 / 0.8 + 2.0 * 4.0 + 2.0
    np.testing.assert_allclose(seconds(start, [there], [3.0]), by_hand, rtol=1e-6)
    # No shorter than straight, which counts where no path is known.
    by_hand = 2.0 / 0.5 + 1.2 / 0.8 + 2.0 * 4.0 + 2.0
    np.testing.assert_allclose(seconds(start, [there] * 2, [np.inf, 1.0]), by_hand, rtol=1e-6)


def test_the_arm_alone_takes_the_time_in_which_it_turns_or_moves_the_camera() -> None:
    start = facing(0.0, START)
    turned, moved = facing(0.8, START), facing(0.0, (1.5, 2.3, 1.2))
    np.testing.assert_allclose(
        seconds(start, [turned, moved], [0.0, 0.3]),
        [0.8 / 0.4 + 2.0, 4.0 * 0.3 / 0.5 + 2.0],
        rtol=1e-6,
    )


def test_the_rating_is_eq_11_with_seconds(situation: Situation) -> None:
    poses = [facing(0.3, (2.45, 1.65, 1.45)), facing(0.3, (1.95, 2.25, 1.35))]
    rated = Rating(SECONDS).rate(options_of(situation, poses, [50.0, 80.0], full=200.0))
    terms = rated.terms
    assert "distance" not in terms
    for i, information in enumerate((50.0, 80.0)):
        total = information / 200.0 - 0.004 * terms["duration"][i]
        assert rated.ratings[i] == pytest.approx(total * (1.0 - terms["risk"][i]))
    np.testing.assert_allclose(rated.distances, terms["duration"] * TIMES.speed)


def test_a_faster_base_makes_far_views_cheaper(situation: Situation) -> None:
    """In meters they cost the same; in seconds a view that is far is preferred only if fast."""
    poses = [facing(0.0, (2.2, 2.0, 1.2)), facing(0.0, (3.4, 2.0, 1.2))]
    best = {}
    for speed in (0.02, 2.0):
        times = dataclasses.replace(TIMES, speed=speed)
        now = dataclasses.replace(situation, times=times)
        for config in (SECONDS, RatingConfig(localization_weight=0.0)):
            options = options_of(now, poses, [60.0, 75.0])
            best[speed, config.cost] = int(Rating(config).rate(options).ratings.argmax())
    assert best[0.02, "seconds"] == 0 and best[2.0, "seconds"] == 1
    assert best[0.02, "distance"] == best[2.0, "distance"]


@pytest.mark.parametrize("depth", [2, 3])
def test_look_ahead_finds_the_sequence_that_is_best_in_seconds(
    situation: Situation, depth: int
) -> None:
    """By the definition, with a second counted as the distance that is driven in it."""
    config = LookAheadConfig(depth=depth, views=5, beam=1000, unlike_distance=0.0)
    gains = {1.9: 40, 2.3: 55, 3.0: 62, 3.6: 70, 4.1: 45}
    told = {x: dict.fromkeys(range(n0, n0 + gains[x]), 1.0) for x, n0 in zip(gains, (0, 20, 60, 90, 140), strict=True)}  # fmt: skip  # noqa: E501
    poses = [facing(0.0, (x, 2.0, 1.2)) for x in gains]
    source = Prescribed(told)
    options = options_of(situation, poses, [float(g) for g in gains.values()], source=source)
    ratings = Rating(SECONDS).rate(options)
    scores = LookAhead(config).score(options, ratings)
    expected = np.full(5, -np.inf)
    for length in range(1, depth + 1):
        for order in itertools.permutations(range(5), length):
            value = _worth(config, options, ratings, list(told.values()), order)
            expected[order[0]] = max(expected[order[0]], value)
    assert scores.values.argmax() == expected.argmax()
    assert scores.values.max() == pytest.approx(expected.max(), rel=0.1)


def _worth(
    config: LookAheadConfig, options: Any, ratings: Any, told: list[dict[int, float]],
    order: tuple[int, ...],
) -> float:  # fmt: skip
    known: set[int] = set()
    total, elapsed, here = 0.0, 0.0, None
    for view in order:
        news = len(set(told[view]) - known)
        known |= set(told[view])
        if here is None:
            step = float(ratings.terms["duration"][view])
        else:
            length = np.linalg.norm(options.positions[view] - options.positions[here])
            step = float(seconds(options.poses[here], [options.poses[view]], [length])[0])
        rating = (news / 100.0 - SECONDS.time_weight * step) * (1.0 - ratings.terms["risk"][view])
        elapsed += step
        discount = np.exp(-elapsed * TIMES.speed / config.discount_distance)
        total += rating * (discount if rating > 0.0 else 1.0)
        here = view
    return total


def test_a_planned_motion_that_takes_longer_costs_more() -> None:
    cost = Cost.of(SECONDS, TIMES)
    planned = Flight(travel=9.0, seconds=30.0)
    assert cost.surcharge(planned, assumed=20.0, length=1.0) == pytest.approx(0.004 * 10.0)
    assert cost.surcharge(Flight(travel=9.0), assumed=20.0, length=1.0) == 0.0  # not known
    distance = Cost.of(RatingConfig(distance_weight=0.02), TIMES)
    assert distance.surcharge(planned, assumed=1.0, length=4.0) == pytest.approx(0.02 * 5.0)
    assert distance.surcharge(planned, assumed=1.0, length=np.inf) == 0.0


def test_the_reason_gives_the_cost_in_its_unit() -> None:
    def reason(**terms: float) -> str:
        view = RatedView(np.eye(4), {"information": 10.0, **terms}, 1.0, 1.0)
        return why_this(view, [view], False, 100.0, "bits")

    assert "12.3 s away" in reason(duration=12.34)
    assert "1.23 m with turns" in reason(distance=1.234)


def test_a_reason_is_read_at_a_glance() -> None:
    pose = np.eye(4)
    pose[:3, 3] = -123.4, -123.4, -12.3
    chosen = RatedView(pose, {"information": 123456.7, "distance": 123.4}, 1.0, 1.0)
    refused = RatedView(
        pose, {}, 2.0, 2.0, "no path of the arm found in 3000 samples; straight on: no"
    )
    told = why_this(chosen, [chosen, *[refused] * 1234], True, 1e6, "bits")
    assert len(f"largest_information: {told}".split()) <= 25
    assert "1234 better ruled out" in told and "12 % of a full view" in told


def test_impossible_times_and_units_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="motion times"):
        MotionTimes(speed=0.0)
    with pytest.raises(InvalidInputError, match="motion times"):
        MotionTimes(look=float("nan"))
    with pytest.raises(ConfigError, match="'cost' is 'meters', expected one of distance, seconds"):
        RatingConfig(cost="meters")
