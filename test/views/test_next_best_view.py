"""The choice as a whole, in rooms where the right answer is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.flight import Flight, FlyingCamera
from infomap_ros.studies.published_metrics import EVERY_METRIC
from infomap_ros.views.decision import GoalMemory, count_reasons
from infomap_ros.views.information.view_information import ExpectedInformation, expected_information
from infomap_ros.views.next_best_view import NextBestView, NextBestViewConfig
from infomap_ros.views.sampling import surroundings
from infomap_ros.views.sampling.candidates import CandidateConfig
from infomap_ros.views.sampling.surroundings import SurroundingsConfig
from infomap_ros.views.selection import SelectionConfig
from infomap_ros.views.situation import RegionOfTask, Situation

from .rooms import CAMERA, facing, seen_room, turning

ROOM = (6.0, 4.0, 2.5)
START = (1.5, 2.0, 1.2)
FEW = NextBestViewConfig(
    candidates=CandidateConfig(candidates=90), selection=SelectionConfig(refined=12)
)


@pytest.fixture(scope="module")
def half_seen() -> Situation:
    """A room of which the camera has seen what lies ahead (+x) and not what lies behind."""
    poses = [facing(angle, START) for angle in (-0.5, 0.0, 0.5)]
    return Situation(
        seen_room(poses, ROOM), CAMERA, 4.0, poses[1], region=RegionOfTask((0, 0, 0), ROOM)
    )


class Robot:
    """Reaches what a rule allows, and counts the questions."""

    def __init__(
        self, cheap: str = "", far: str = "", partial: bool = False, travel: float = 0.0
    ) -> None:
        self.cheap, self.far, self.partial, self.travel = cheap, far, partial, travel
        self.asked, self.planned = 0, 0

    def may_reach(self, poses: np.ndarray) -> Sequence[str]:
        self.asked += len(poses)
        return [self.cheap] * len(poses)

    def reach(self, T_map_camera: np.ndarray) -> Flight:
        self.planned += 1
        return Flight(reason=self.far, partial=self.partial, travel=self.travel)


def choose(situation: Situation, robot: object = None, config: object = FEW, **more: object):
    chooser = NextBestView(config, **{k: more.pop(k) for k in ("strategy",) if k in more})
    reachability = robot or FlyingCamera(situation.T_map_camera)
    return chooser.select(situation, reachability, np.random.default_rng(1), **more)


def test_looks_at_what_is_unknown(half_seen: Situation) -> None:
    decision = choose(half_seen)
    assert decision.chosen is not None and decision.reach is not None
    assert decision.chosen.pose[0, 2] < 0.0  # towards -x, where nothing was seen
    best = max(view.rating for view in decision.candidates if view.fine)
    assert decision.chosen.rating == best


def test_same_seed_same_choice(half_seen: Situation) -> None:
    first, second = choose(half_seen), choose(half_seen)
    np.testing.assert_array_equal(first.chosen.pose, second.chosen.pose)
    assert first.chosen.terms == second.chosen.terms


def test_every_candidate_has_terms_or_a_reason(half_seen: Situation) -> None:
    decision = choose(half_seen)
    gains = {"information", "interest", "teammates", "repetition"}
    names = gains | {"distance", "localization_error", "risk"}
    for view in decision.candidates:
        assert set(view.terms) == names or view.rejection
    assert any(view is decision.chosen for view in decision.candidates)


def test_unreachable_everywhere_is_said(half_seen: Situation) -> None:
    robot = Robot(cheap="no inverse kinematics")
    decision = choose(half_seen, robot)
    assert decision.chosen is None and decision.reach is None
    assert "no inverse kinematics" in decision.reason
    assert robot.planned == 0


def test_motions_are_planned_to_a_bounded_number_of_views(half_seen: Situation) -> None:
    robot = Robot(far="base path: none")
    config = dataclasses.replace(FEW, selection=SelectionConfig(refined=12, attempts=5))
    decision = choose(half_seen, robot, config)
    assert decision.chosen is None and robot.planned == 5
    assert decision.rejections()["base path: none"] == 5


class BehindTheScreen(Robot):
    """Cannot reach one half of the room."""

    def reach(self, T_map_camera: np.ndarray) -> Flight:
        self.planned += 1
        return Flight("no path" if T_map_camera[0, 3] > 1.6 else "")


def test_what_fails_in_one_place_is_next_tried_elsewhere(half_seen: Situation) -> None:
    few = SelectionConfig(refined=12, attempts=6)
    robot = BehindTheScreen()
    decision = choose(half_seen, robot, dataclasses.replace(FEW, selection=few))
    failed = [view.pose[:3, 3] for view in decision.candidates if view.rejection == "no path"]
    gaps = np.linalg.norm(np.array(failed)[:, None] - failed, axis=-1)
    assert len(failed) >= 3 and gaps[np.triu_indices(len(failed), 1)].min() > 0.5


def test_next_best_are_refined_when_the_best_all_fail(half_seen: Situation) -> None:
    few = SelectionConfig(refined=4, attempts=60)
    decision = choose(half_seen, BehindTheScreen(), dataclasses.replace(FEW, selection=few))
    assert decision.chosen is not None and decision.chosen.fine
    assert decision.chosen.pose[0, 3] <= 1.6
    assert sum(view.fine for view in decision.candidates) > 4


def test_partial_approach_is_second_best(half_seen: Situation) -> None:
    robot = Robot(far="base path: ends early", partial=True, travel=1.0)
    decision = choose(half_seen, robot)
    assert decision.chosen is not None and decision.reach is not None and decision.reach.partial
    assert decision.chosen.rejection == "base path: ends early"


def test_partial_approach_that_leads_nowhere_is_none(half_seen: Situation) -> None:
    robot = Robot(far="base path: ends early", partial=True, travel=0.05)
    assert choose(half_seen, robot).chosen is None


def test_nothing_is_chosen_in_a_known_room() -> None:
    poses = [*turning((1.5, 2.0, 1.2), 8), *turning((4.5, 2.0, 1.2), 8)]
    poses += [facing(a, (3.0, 2.0, 1.2), e) for a in (0, 1.6, 3.1, 4.7) for e in (-1.2, -0.6, 0.7)]
    voxel_map = seen_room(poses, ROOM)
    region = RegionOfTask((1.0, 1.0, 0.5), (5.0, 3.0, 1.9))
    decision = choose(Situation(voxel_map, CAMERA, 4.0, poses[0], region=region))
    assert decision.chosen is None
    assert "ruled out" in decision.reason


def test_stages_are_timed(half_seen: Situation) -> None:
    seconds = choose(half_seen).seconds
    stages = ["surroundings", "candidates", "information", "rating", "may_reach"]
    assert list(seconds) == [*stages, "refinement", "reach"]
    assert all(spent >= 0.0 for spent in seconds.values())


def test_reason_says_what_speaks_for_the_view(half_seen: Situation) -> None:
    decision = choose(half_seen)
    assert decision.chosen is not None
    assert f"{decision.chosen.terms['information']:.0f} bits" in decision.reason
    assert "of a full view" in decision.reason and "largest_information" in decision.reason


def test_robot_is_asked_in_batches_and_for_a_plan_only_once(half_seen: Situation) -> None:
    robot = Robot()
    decision = choose(half_seen, robot)
    assert decision.chosen is not None and robot.planned == 1
    assert 1 <= robot.asked <= 90


def test_information_is_exact_for_the_views_that_decide(half_seen: Situation) -> None:
    decision = choose(half_seen)
    fine = [view for view in decision.candidates if view.fine]
    assert len(fine) == FEW.selection.refined
    poses = np.array([view.pose for view in fine])
    region = np.stack([half_seen.region.low, half_seen.region.high])
    exact = expected_information(half_seen.voxel_map, poses, CAMERA, 4.0, region=region)
    given = [view.terms["information"] for view in fine]
    np.testing.assert_allclose(given, exact)


def test_goal_is_kept_until_clearly_beaten(half_seen: Situation) -> None:
    best = choose(half_seen).chosen
    assert best is not None
    scores = {0.9: True, 0.5: False}  # share of the best score, and whether the goal is kept
    for share, kept in scores.items():
        ranked = [v for v in choose(half_seen).candidates if v.fine and not v.rejection]
        goal = min(ranked, key=lambda view: abs(view.score - share * best.score)).pose
        decision = choose(half_seen, previous_goal=goal)
        assert decision.chosen is not None
        assert np.array_equal(decision.chosen.pose, goal) == kept
        assert ("still the view from" in decision.reason) == kept


def test_goal_that_has_become_impossible_is_given_up(half_seen: Situation) -> None:
    inside_the_wall = facing(0.0, (6.05, 2.0, 1.2))
    decision = choose(half_seen, previous_goal=inside_the_wall)
    assert decision.chosen is not None
    assert not np.array_equal(decision.chosen.pose, inside_the_wall)
    given_up = [v for v in decision.candidates if np.array_equal(v.pose, inside_the_wall)]
    assert len(given_up) == 1 and given_up[0].rejection


def test_no_oscillation_between_equal_goals() -> None:
    """Much is unknown on all sides: what is chosen first stays the goal on the way there."""
    voxel_map = seen_room(turning((3.0, 2.0, 1.2), 8), ROOM)
    region, goal, choices = RegionOfTask((0, 0, 0), ROOM), None, []
    many = dataclasses.replace(FEW, candidates=CandidateConfig(candidates=300))
    for step in range(4):
        pose = facing(1.6, (3.0, 2.0 + 0.1 * step, 1.2))
        now = Situation(voxel_map, CAMERA, 4.0, pose, region=region)
        decision = NextBestView(many).select(
            now, FlyingCamera(pose), np.random.default_rng(step), previous_goal=goal
        )
        assert decision.chosen is not None
        goal = decision.chosen.pose
        choices.append(goal)
    for choice in choices[1:]:
        np.testing.assert_array_equal(choice, choices[0])


def test_remembered_goals_are_not_tried_again(half_seen: Situation) -> None:
    best = choose(half_seen).chosen
    assert best is not None
    memory = GoalMemory()
    memory.remember(best.pose, "no path", half_seen.voxel_map)
    decision = choose(
        half_seen,
        known_unreachable=lambda poses: memory.reasons_against(poses, half_seen.voxel_map),
    )
    assert decision.chosen is not None
    assert not np.array_equal(decision.chosen.pose, best.pose)
    assert any("no path" in view.rejection for view in decision.candidates)


class LongRoute(Robot):
    """The route to one view is far longer than it looks."""

    def __init__(self, pose: np.ndarray, travel: float) -> None:
        super().__init__()
        self.pose, self.travel = pose, travel

    def reach(self, T_map_camera: np.ndarray) -> Flight:
        self.planned += 1
        return Flight(travel=self.travel if np.array_equal(T_map_camera, self.pose) else 0.0)


def test_view_loses_when_its_route_turns_out_long(half_seen: Situation) -> None:
    best = choose(half_seen).chosen
    assert best is not None
    robot = LongRoute(best.pose, 200.0)
    decision = choose(half_seen, robot)
    assert decision.chosen is not None and robot.planned == 2
    assert not np.array_equal(decision.chosen.pose, best.pose)
    slightly = LongRoute(best.pose, 0.1)
    assert np.array_equal(choose(half_seen, slightly).chosen.pose, best.pose)


def test_search_widens_where_nothing_near_is_worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    poses = [*turning(START, 8), facing(0.0, (3.0, 2.0, 1.2)), *turning((8.0, 2.0, 1.2), 2)]
    voxel_map = seen_room(poses, (16.0, 4.0, 2.5))
    region = RegionOfTask((9.0, 0.0, 0.0), (16.0, 4.0, 2.5))
    now = Situation(voxel_map, CAMERA, 4.0, facing(0.0, START), region=region)
    near = dataclasses.replace(FEW, surroundings=SurroundingsConfig(horizon=2.0))
    decision = choose(now, config=near)
    assert decision.chosen is not None
    assert decision.chosen.pose[0, 3] > START[0] + 2.0
    gaps = [np.linalg.norm(view.pose[:3, 3] - START) for view in decision.candidates]
    assert sum(gap < 2.0 for gap in gaps) > 10  # those considered first are not forgotten
    monkeypatch.setattr(surroundings, "_LARGEST_WINDOW", 1000)
    limited = choose(now, config=near)
    assert limited.chosen is None and "farther away" in limited.reason


def test_empty_map_gives_the_views_from_where_the_camera_is() -> None:
    now = Situation(VoxelMap(), CAMERA, 4.0, facing(0.0, START))
    decision = choose(now)
    assert decision.chosen is not None
    np.testing.assert_allclose(decision.chosen.pose[:3, 3], START, atol=0.25)


@pytest.mark.parametrize(
    "strategy", ["random", "raster", "largest_unknown", "smallest_known", "look_ahead"]
)
def test_every_strategy_goes_through_the_same_loop(half_seen: Situation, strategy: str) -> None:
    decision = choose(half_seen, strategy=strategy)
    assert decision.chosen is not None and decision.strategy == strategy
    best = max(view.score for view in decision.candidates if view.fine and not view.rejection)
    assert decision.chosen.score == best


def test_sequence_that_is_planned_is_told(half_seen: Situation) -> None:
    decision = choose(half_seen, strategy="look_ahead")
    assert 1 <= len(decision.plan) <= 2
    poses = [view.pose for view in decision.candidates if view.fine]
    for pose in decision.plan:
        assert any(np.array_equal(pose, other) for other in poses)


class Forgetful(Robot):
    """Answers less than it is asked."""

    def may_reach(self, poses: np.ndarray) -> Sequence[str]:
        return [""]


def test_wrong_number_of_answers_is_an_error(half_seen: Situation) -> None:
    with pytest.raises(InvalidInputError, match="reachability"):
        choose(half_seen, Forgetful())


@pytest.mark.parametrize("metric", sorted(EVERY_METRIC))
def test_every_metric_can_choose(half_seen: Situation, metric: str) -> None:
    few = dataclasses.replace(
        FEW,
        candidates=CandidateConfig(candidates=30),
        selection=SelectionConfig(refined=5),
    )
    source = ExpectedInformation(EVERY_METRIC[metric], quick_ray_spacing=0.1)
    decision = NextBestView(few, information=source).select(
        half_seen, FlyingCamera(half_seen.T_map_camera), np.random.default_rng(0)
    )
    assert decision.chosen is not None
    ratings = [view.rating for view in decision.candidates if view.fine]
    assert len(set(ratings)) > 1 and np.isfinite(ratings).all()
    assert source.unit in decision.reason


def test_reasons_that_differ_in_numbers_count_as_one() -> None:
    reasons = ("reach: 1.2 m", "reach: 0.7 m", "no path", "", "reach: 13 m")
    assert count_reasons((reason, 1) for reason in reasons if reason) == {
        "reach: 1.2 m": 3,
        "no path": 1,
    }


def test_unknown_metric_is_refused() -> None:
    with pytest.raises(ConfigError, match="expected_entropy_reduction"):
        ExpectedInformation("entropy_of_everything")
