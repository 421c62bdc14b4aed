"""Rating against eqs. (10) and (11) by hand, and its units."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import Box, PinholeCamera, PlacedSolid, Sphere, make_transform
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.information.view_query import InformationConfig
from infomap_ros.views.ranking import terms
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Rating, RatingConfig, pose_information_loss
from infomap_ros.views.ranking.terms import (
    POSITION_PER_METER,
    ROTATION_PER_METER,
    TRUST_AZIMUTH,
    Distance,
    OdometryDrift,
)
from infomap_ros.views.sampling.candidates import CandidateConfig, find_candidates
from infomap_ros.views.sampling.surroundings import survey
from infomap_ros.views.situation import Interest, RegionOfTask, Situation, Teammate

from .choices import Prescribed, options_of
from .rooms import CAMERA, facing, seen_room, turning

ROOM = (6.0, 4.0, 2.5)
START = (1.5, 2.0, 1.2)


@pytest.fixture(scope="module")
def situation() -> Situation:
    """A room seen all around from one place."""
    poses = turning(START, 8)
    return Situation(seen_room(poses, ROOM), CAMERA, 4.0, poses[0])


def with_fields(situation: Situation, **fields: object) -> Situation:
    return Situation(**{**situation.__dict__, **fields})


def test_distance_is_eq_10(situation: Situation) -> None:
    pose = facing(0.8, (2.5, 1.6, 1.4))
    distance = Distance((1.0, 2.0, 3.0), (0.1, 0.2, 0.5))(options_of(situation, [pose], [0.0]))
    moved = np.array((1.0, -0.4, 0.2))
    squares = ((np.array((1.0, 2.0, 3.0)) * moved) ** 2).sum() + (0.5 * 0.8) ** 2
    assert distance[0] == pytest.approx(np.sqrt(squares), rel=0.05)


def test_rating_is_eq_11(situation: Situation) -> None:
    config = RatingConfig(information_weight=2.0, distance_weight=0.3, localization_weight=0.7)
    rating = Rating(config, localization_error=lambda _, poses, lengths: 0.1 * np.ones(len(poses)))
    poses = [facing(0.3, (2.45, 1.65, 1.45)), facing(0.3, (1.95, 2.25, 1.35))]
    rated = rating.rate(options_of(situation, poses, [50.0, 80.0], full=200.0))
    terms = rated.terms
    assert 0.0 < terms["risk"][0] < 0.06
    loss = pose_information_loss(situation, InformationConfig(), [0.1])[0]
    assert loss > 0.0
    for i, information in enumerate((50.0, 80.0)):
        total = 2.0 * information / 200.0 - 0.3 * terms["distance"][i] - 0.7 * loss
        assert rated.ratings[i] == pytest.approx(total * (1.0 - terms["risk"][i]))


def test_risk_lowers_gains_and_raises_losses(situation: Situation) -> None:
    mate = Teammate(np.array((2.6, 2.0, 1.2)))
    poses = [facing(0.0, (2.5, 2.0, 1.2)), facing(0.0, (2.0, 2.9, 1.2))]
    near = with_fields(situation, teammates=(mate,))
    for information, sign in ((50.0, 1.0), (0.0, -1.0)):
        alone = Rating().rate(options_of(situation, poses, [information] * 2)).ratings
        rated = Rating().rate(options_of(near, poses, [information] * 2))
        assert rated.terms["risk"][0] > 0.9 > 0.3 > rated.terms["risk"][1]
        assert np.sign(alone[0]) == sign
        assert rated.ratings[0] < alone[0] - 0.5 * abs(alone[0])


def test_interest_multiplies_the_information_inside(situation: Situation) -> None:
    place = make_transform(np.eye(3), (6.0, 2.0, 1.0))
    pose = facing(0.0, (4.0, 2.0, 1.2))
    for weight in (3.0, 0.0):
        everywhere = Interest(PlacedSolid(Sphere(20.0), place), weight)
        terms = (
            Rating()
            .rate(options_of(with_fields(situation, interests=(everywhere,)), [pose], [50.0]))
            .terms
        )
        assert terms["interest"][0] == pytest.approx(50.0 * (weight - 1.0), rel=0.1)


def test_interest_draws_the_view_that_sees_it(situation: Situation) -> None:
    place = make_transform(np.eye(3), (1.0, 0.0, 1.0))
    wanted = Interest(PlacedSolid(Box((2.0, 0.6, 2.0)), place), 10.0)
    poses = [facing(angle, START) for angle in (0.0, np.pi / 2, -np.pi / 2)]
    plain = Rating().rate(options_of(situation, poses, [50.0, 50.0, 50.0]))
    drawn = Rating().rate(
        options_of(with_fields(situation, interests=(wanted,)), poses, [50.0, 50.0, 50.0])
    )
    np.testing.assert_array_equal(plain.terms["interest"], 0.0)
    assert drawn.ratings.argmax() == 2
    assert drawn.terms["interest"][1] == pytest.approx(0.0, abs=1.0)


def test_what_a_teammate_is_about_to_see_counts_less(situation: Situation) -> None:
    poses = [facing(0.0, (2.5, 2.0, 1.2)), facing(np.pi, (1.2, 2.0, 1.2))]
    mate = Teammate(np.array((1.5, 3.5, 1.2)), facing(0.0, (2.4, 2.0, 1.2)), 4.0)
    together = with_fields(situation, teammates=(mate,))
    terms = Rating().rate(options_of(together, poses, [50, 50], fine=False))
    loss = terms.terms["teammates"]
    assert loss[0] < -25.0 and loss[1] == pytest.approx(0.0, abs=2.0)
    assert terms.shares[0] == pytest.approx((50.0 + loss[0]) / 100.0)


def test_what_a_like_view_has_not_told_is_taken_off(situation: Situation) -> None:
    """The past view from x = 2.5 still promises 40 bits."""
    past, other = facing(0.0, (2.5, 2.0, 1.2)), facing(np.pi, (2.5, 2.0, 1.2))
    raised, beside = facing(0.0, (2.5, 2.0, 1.2), 0.3), facing(0.6, (2.5, 3.5, 1.2))
    source = Prescribed({2.5: {1: 40.0}})
    now = with_fields(situation, past_views=past[None])
    poses, information = [past, past, other, raised, beside], [40.0, 30.0, 50.0, 50.0, 50.0]
    rated = Rating().rate(options_of(now, poses, information, source=source))
    expected = [-40.0, -30.0, 0.0, -40.0 * np.exp(-2.0), -40.0 * np.exp(-1.0)]
    np.testing.assert_allclose(rated.terms["repetition"], expected, atol=1e-3)
    left = np.array(information) + rated.terms["repetition"]
    np.testing.assert_allclose(rated.shares, left / 100.0)


def test_a_view_is_trusted_as_far_as_views_of_its_elevation_have_kept_their_promises(
    situation: Situation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three views upwards one told a half and two nothing; a level one told all."""
    up, level = facing(0.0, (1.5, 2.0, 1.2), 0.6), facing(0.0, (1.5, 2.0, 1.2))
    past, kept = np.stack([up, up, up, level]), np.array((0.5, 0.0, 0.0, 1.0))
    now = with_fields(situation, past_views=past, kept_shares=kept)
    for name, value in (
        ("_TRUST_DISTANCE", 1e3),
        ("_TRUST_CREDIT", 0.5),
        ("_LIKE_ELEVATION", 0.05),
    ):
        monkeypatch.setattr(terms, name, value)
    beside = facing(0.0, (2.5, 2.5, 1.2), 0.6)
    turned = facing(2.0, (1.5, 2.0, 1.2), 0.6)
    rated = Rating().rate(
        options_of(now, [beside, turned, level], [40.0, 40.0, 40.0], source=Prescribed({}))
    )
    alike = 3.0 * np.exp(-0.5 * (2.0 * np.cos(0.6) / TRUST_AZIMUTH) ** 2)
    shares = [2.5 / 3.5, (2.5 / 3.0) * alike / (alike + 0.5), 0.0]
    np.testing.assert_allclose(rated.terms["repetition"], -40.0 * np.array(shares), atol=1e-6)


def test_of_views_that_are_not_known_to_have_told_nothing_is_concluded(
    situation: Situation,
) -> None:
    level = facing(0.0, (1.5, 2.0, 1.2))
    for kept in (np.array((np.nan,)), np.empty(0)):
        now = with_fields(situation, past_views=level[None], kept_shares=kept)
        rated = Rating().rate(options_of(now, [level], [40.0], source=Prescribed({})))
        np.testing.assert_array_equal(rated.terms["repetition"], 0.0)
    with pytest.raises(InvalidInputError, match="kept_shares"):
        with_fields(situation, past_views=level[None], kept_shares=np.ones(2))


def test_further_terms_are_weighted_in_their_unit(situation: Situation) -> None:
    class Sun:
        name, unit = "sun", "rad"

        def __call__(self, options: Options) -> np.ndarray:
            return np.arange(len(options), dtype=float)

    class Color:
        name, unit = "color", "bits"

        def __call__(self, options: Options) -> np.ndarray:
            return np.full(len(options), 30.0)

    poses = [facing(0.0, START)] * 3
    plain = Rating().rate(options_of(situation, poses, [50.0] * 3, full=200.0))
    more = Rating(more_terms=[(Sun(), 0.2), (Color(), 2.0)])
    rated = more.rate(options_of(situation, poses, [50.0] * 3, full=200.0))
    np.testing.assert_allclose(
        rated.ratings - plain.ratings, 0.2 * np.arange(3) + 2.0 * 30.0 / 200.0
    )
    np.testing.assert_array_equal(rated.terms["sun"], [0.0, 1.0, 2.0])


def test_localization_error_is_that_of_a_random_walk() -> None:
    """Against simulated motion with the drift that the constants state."""
    rng = np.random.default_rng(0)
    runs, steps, length = 20000, 200, 4.0
    step = length / steps
    start = rng.normal(0.0, (0.1, 0.1, 0.03), (runs, 3))
    heading = start[:, 2] + ROTATION_PER_METER * np.sqrt(step) * np.cumsum(
        rng.normal(size=(steps, runs)), 0
    )
    x = start[:, 0] + (step * (np.cos(heading) - 1.0)).sum(axis=0)
    y = start[:, 1] + (step * np.sin(heading)).sum(axis=0)
    noise = POSITION_PER_METER * np.sqrt(length / 3.0) * rng.normal(size=(3, runs))
    variance = x.var() + y.var() + 0.0 + (noise**2).sum(axis=0).mean()
    covariance = np.diag((0.1**2, 0.1**2, 0.0, 0.0, 0.0, 0.03**2))
    pose = facing(0.0, START)
    there = facing(0.0, (1.5 + length, 2.0, 1.2))
    now = Situation(seen_room([], ROOM), CAMERA, 4.0, pose, covariance)
    error = OdometryDrift()(now, there[None], np.array([length]))[0]
    assert error == pytest.approx(np.sqrt(variance) - np.sqrt(0.02), rel=0.05)


def test_standing_still_costs_nothing(situation: Situation) -> None:
    rated = Rating().rate(options_of(situation, [situation.T_map_camera], [0.0]))
    assert rated.ratings[0] == pytest.approx(0.0, abs=1e-9)


def narrow(focal_length: float) -> PinholeCamera:
    return PinholeCamera(80, 60, focal_length, focal_length, 39.5, 29.5)


@pytest.fixture(scope="module")
def rated_by_scale() -> dict[tuple[float, float], np.ndarray]:
    """Ratings of the same 150 views of one scene, by voxel size and focal length."""
    block = ((3.0, 1.0, 0.0, 3.6, 1.8, 1.4),)
    seen = [facing(angle, START) for angle in (-0.5, 0.0, 0.5)]
    ratings, poses = {}, None
    for voxel_size in (0.1, 0.05):
        voxel_map = seen_room(seen, ROOM, block, voxel_size)
        for focal_length in (35.0, 50.0, 70.0) if voxel_size > 0.07 else (35.0, 50.0):
            region = RegionOfTask((0, 0, 0), ROOM)
            now = Situation(voxel_map, narrow(focal_length), 4.0, seen[1], region=region)
            around, source = survey(now), ExpectedInformation()
            if poses is None:
                rng = np.random.default_rng(0)
                poses = find_candidates(now, around, rng, CandidateConfig(candidates=150)).poses
            bits, full = source.exact(now, poses), source.full_view(now)
            options = Options(now, around, poses, bits, full, source, np.random.default_rng(0))
            ratings[voxel_size, focal_length] = Rating().rate(options).ratings
    return ratings


@pytest.mark.parametrize("scale", [(0.05, 50.0), (0.1, 35.0), (0.1, 70.0), (0.05, 35.0)])
def test_choice_does_not_depend_on_resolution_or_field_of_view(
    rated_by_scale: dict[tuple[float, float], np.ndarray], scale: tuple[float, float]
) -> None:
    """Bits themselves differ by factors of 6 to 16."""
    reference, other = rated_by_scale[0.1, 50.0], rated_by_scale[scale]
    assert reference[other.argmax()] >= reference.max() - 0.1 * np.ptp(reference)
    assert 0.7 < np.polyfit(reference, other, 1)[0] < 1.4
    clearly_better = reference[:, None] - reference > 0.15 * np.ptp(reference)
    assert clearly_better.mean() > 0.2
    assert (other[:, None] > other)[clearly_better].mean() > 0.97


def test_full_unknown_view_rates_one() -> None:
    empty = seen_room([], ROOM)
    pose = facing(0.4, START)
    for focal_length in (35.0, 70.0):
        now = Situation(empty, narrow(focal_length), 4.0, pose)
        source = ExpectedInformation()
        bits = source.exact(now, pose[None])
        options = options_of(now, [pose], bits, full=source.full_view(now))
        assert Rating().rate(options).ratings[0] == pytest.approx(1.0, rel=0.01)


def test_glances_measure_volumes() -> None:
    now = Situation(seen_room([], ROOM), CAMERA, 4.0, facing(0.0, START))
    unknown = options_of(now, [facing(1.0, START)], [0.0]).coarse_views.unknown[0]
    u, v = np.meshgrid(np.linspace(-0.5, 79.5, 400), np.linspace(-0.5, 59.5, 300))
    cosines = 1.0 / np.sqrt(((u - 39.5) / 50.0) ** 2 + ((v - 29.5) / 50.0) ** 2 + 1.0)
    volume = (cosines**3).mean() * (80.0 * 60.0 / 50.0**2) * 4.0**3 / 3.0
    assert unknown == pytest.approx(volume, rel=0.05)
