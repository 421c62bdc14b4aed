"""The choice as a whole, in rooms where the right answer is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from infomap_ros.views.candidates import CandidateConfig
from infomap_ros.views.next_best_view import NextBestView, NextBestViewConfig
from infomap_ros.views.reach import Flight, FlyingCamera
from infomap_ros.views.selection import SelectionConfig
from infomap_ros.views.situation import RegionOfTask, Situation

from .rooms import CAMERA, facing, seen_room, turning

ROOM = (6.0, 4.0, 2.5)
START = (1.5, 2.0, 1.2)
FEW = NextBestViewConfig(candidates=CandidateConfig(candidates=120))


@pytest.fixture(scope="module")
def half_seen() -> Situation:
    """A room of which the camera has seen what lies ahead (+x) and not what lies behind."""
    poses = [facing(angle, START) for angle in (-0.5, 0.0, 0.5)]
    return Situation(
        seen_room(poses, ROOM), CAMERA, 4.0, poses[1], region=RegionOfTask((0, 0, 0), ROOM)
    )


class Robot:
    """Reaches what a rule allows, and counts the questions."""

    def __init__(self, cheap: str = "", far: str = "", partial: bool = False) -> None:
        self.cheap, self.far, self.partial = cheap, far, partial
        self.asked, self.planned = 0, 0

    def may_reach(self, poses: np.ndarray) -> Sequence[str]:
        self.asked += len(poses)
        return [self.cheap] * len(poses)

    def reach(self, T_map_camera: np.ndarray) -> Flight:
        self.planned += 1
        return Flight(reason=self.far, partial=self.partial)


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
    names = {"information", "interest", "teammates", "distance", "localisation_error", "risk"}
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
    config = dataclasses.replace(FEW, selection=SelectionConfig(reach_attempts=5))
    decision = choose(half_seen, robot, config)
    assert decision.chosen is None and robot.planned == 5
    assert decision.rejections()["base path: none"] == 5


def test_partial_approach_is_second_best(half_seen: Situation) -> None:
    robot = Robot(far="base path: ends early", partial=True)
    decision = choose(half_seen, robot)
    assert decision.chosen is not None and decision.reach is not None and decision.reach.partial
    assert decision.chosen.rejection == "base path: ends early"


def test_nothing_is_chosen_in_a_known_room() -> None:
    poses = [*turning((1.5, 2.0, 1.2), 8), *turning((4.5, 2.0, 1.2), 8)]
    poses += [facing(a, (3.0, 2.0, 1.2), e) for a in (0, 1.6, 3.1, 4.7) for e in (-1.2, -0.6, 0.7)]
    voxel_map = seen_room(poses, ROOM)
    region = RegionOfTask((1.0, 1.0, 0.5), (5.0, 3.0, 1.9))
    decision = choose(Situation(voxel_map, CAMERA, 4.0, poses[0], region=region))
    assert decision.chosen is None
    assert "ruled out" in decision.reason
