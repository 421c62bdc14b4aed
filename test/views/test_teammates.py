"""What teammates are about to see is counted once and left to them; their places stay clear."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.flight import FlyingCamera
from infomap_ros.views.decision import ViewDecision
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.next_best_view import NextBestView, NextBestViewConfig
from infomap_ros.views.ranking.options import claimed_gains, shares_left
from infomap_ros.views.ranking.rating import Rating
from infomap_ros.views.sampling.candidates import NEAR_TEAMMATE, CandidateConfig, find_candidates
from infomap_ros.views.sampling.surroundings import survey
from infomap_ros.views.selection import LEFT_TO_TEAMMATE, SelectionConfig
from infomap_ros.views.situation import RegionOfTask, Situation, Teammate

from .choices import Prescribed, options_of
from .rooms import CAMERA, facing, seen_room

ROOM = (6.0, 4.0, 2.5)
START = (2.0, 2.0, 1.2)
FAR_AWAY = np.array((50.0, 50.0, 1.0))
FEW = NextBestViewConfig(
    candidates=CandidateConfig(candidates=120), selection=SelectionConfig(refined=12)
)


@pytest.fixture(scope="module")
def middle() -> Situation:
    """A room seen ahead (+x) and behind (-x), not to the sides."""
    poses = [facing(angle, START) for angle in (-0.3, 0.3, np.pi - 0.3, np.pi + 0.3)]
    task = RegionOfTask(np.zeros(3), np.array(ROOM))
    return Situation(seen_room(poses, ROOM), CAMERA, 4.0, poses[0], region=task)


def together(situation: Situation, *mates: Teammate) -> Situation:
    return dataclasses.replace(situation, teammates=mates)


def test_of_a_voxel_that_both_see_only_what_is_more_is_left(middle: Situation) -> None:
    """Views by x: two teammates at 3 and 4, and own ones at 1 and 2."""
    source = Prescribed(
        {
            3.0: {10: 4.0, 11: 1.0},
            4.0: {10: 6.0, 12: 2.0},
            1.0: {10: 8.0, 11: 3.0, 20: 5.0},
            2.0: {21: 7.0},
        }
    )
    goals = [facing(0.0, (x, 2.0, 1.2)) for x in (3.0, 4.0)]
    mates = [Teammate(FAR_AWAY, goal, 4.0) for goal in goals]
    poses = [facing(0.0, (x, 2.0, 1.2)) for x in (1.0, 2.0)]
    options = options_of(together(middle, *mates), poses, [16.0, 7.0], source=source)
    terms = Rating().rate(options).terms
    np.testing.assert_allclose(terms["teammates"], [-(6.0 + 1.0), 0.0])


def test_it_is_by_what_the_goal_sees_and_not_by_distance(middle: Situation) -> None:
    """From one place to either side; and from afar into the same corner."""
    source = ExpectedInformation(threads=1)
    mate = Teammate(FAR_AWAY, facing(np.pi / 2, START), 4.0)
    situation = together(middle, mate)
    claimed = claimed_gains(source, situation)
    same, opposite = facing(np.pi / 2, START), facing(-np.pi / 2, START)
    from_afar = facing(np.pi / 2 - 0.4, (1.2, 1.9, 1.3))
    left = shares_left(source, situation, np.array([same, opposite, from_afar]), claimed)
    assert left[0] == pytest.approx(0.0, abs=1e-9)
    assert left[1] == pytest.approx(1.0, abs=0.02)
    assert 0.1 < left[2] < 0.7


def test_what_is_hidden_from_the_teammate_is_left(middle: Situation) -> None:
    """The goal looks through a wall that is known, at what one's own view sees from behind it."""
    source = ExpectedInformation(threads=1)
    beyond = facing(0.0, (-3.0, 2.0, 1.2))
    own = facing(np.pi / 2, START)
    situation = together(middle, Teammate(FAR_AWAY, beyond, 7.0))
    left = shares_left(source, situation, own[None], claimed_gains(source, situation))
    assert left[0] > 0.95


def test_the_teammates_own_camera_and_range_count(middle: Situation) -> None:
    source = ExpectedInformation(threads=1)
    goal = facing(np.pi / 2, START)
    narrow = PinholeCamera(width=80, height=60, fx=200.0, fy=200.0, cx=39.5, cy=29.5)
    lefts = []
    for mate in (
        Teammate(FAR_AWAY, goal, 4.0),
        Teammate(FAR_AWAY, goal, 0.8),
        Teammate(FAR_AWAY, goal, 4.0, narrow),
    ):
        situation = together(middle, mate)
        claimed = claimed_gains(source, situation)
        lefts.append(float(shares_left(source, situation, goal[None], claimed)[0]))
    assert lefts[0] == pytest.approx(0.0, abs=1e-9)
    assert lefts[1] > 0.3
    assert lefts[2] > 0.5


def test_a_teammate_without_a_goal_takes_nothing(middle: Situation) -> None:
    situation = together(middle, Teammate(np.array(START)))
    assert claimed_gains(ExpectedInformation(), situation) is None
    np.testing.assert_array_equal(
        shares_left(ExpectedInformation(), situation, facing(0.0, START)[None], None), 1.0
    )


def test_the_first_ranking_knows_it_beyond_what_is_known_of_the_map() -> None:
    """Nothing is known behind the camera, where both are about to look."""
    here, back = facing(0.0, START), facing(np.pi, START)
    situation = Situation(seen_room([here], ROOM), CAMERA, 4.0, here)
    mate = Teammate(FAR_AWAY, back, 4.0)
    options = options_of(together(situation, mate), [back, here], [50.0, 50.0], fine=False)
    assert options.left[0] < 0.3
    assert options.left[1] == pytest.approx(1.0, abs=1e-9)


def choose(situation: Situation, seed: int = 0) -> ViewDecision:
    return NextBestView(FEW, information=ExpectedInformation(threads=1)).select(
        situation, FlyingCamera(situation.T_map_camera), np.random.default_rng(seed)
    )


def test_the_view_of_a_teammate_is_left_to_it_and_the_choice_says_so(middle: Situation) -> None:
    alone = choose(middle)
    assert alone.chosen is not None
    goal = alone.chosen.pose
    mate = Teammate(FAR_AWAY, goal, 4.0)
    decision = choose(together(middle, mate))
    assert decision.chosen is not None
    situation, source = together(middle, mate), ExpectedInformation(threads=1)
    claimed = claimed_gains(source, situation)
    left = shares_left(source, situation, decision.chosen.pose[None], claimed)
    assert left[0] >= 0.5
    assert decision.rejections()[LEFT_TO_TEAMMATE] > 0
    assert any(view.terms.get("teammates", 0.0) < -1.0 for view in decision.candidates)


def test_no_view_near_its_body_or_where_it_is_going_to_stand() -> None:
    voxel_map: VoxelMap = seen_room([facing(a, START) for a in np.arange(8) * np.pi / 4], ROOM)
    here = facing(0.0, START)
    body = np.array((4.0, 2.0, 0.5))
    mate = Teammate(body, radius=0.8, stand=np.array((2.0, 3.4, 0.5)))
    situation = Situation(voxel_map, CAMERA, 4.0, here, teammates=(mate,))
    config = CandidateConfig(candidates=400, teammate_clearance=0.2)
    rng = np.random.default_rng(3)
    found = find_candidates(situation, survey(situation), rng, config)
    for place in (body, np.array((2.0, 3.4, 0.5))):
        assert np.linalg.norm(found.positions - place, axis=1).min() >= 1.0
        rejected = np.linalg.norm(found.rejected[:, :3, 3] - place, axis=1)
        assert NEAR_TEAMMATE in {found.reasons[i] for i in np.flatnonzero(rejected < 1.0)}
