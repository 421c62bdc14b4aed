"""A robot stops for a teammate that comes its way, and drives on when it has gone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.exploration.robot import Interrupted, Motion, RobotState
from infomap_ros.exploration.team.keep_clear import (
    PAUSE,
    Awareness,
    KeepsClear,
    rest_of,
)
from infomap_ros.geometry import Cylinder, PinholeCamera, PlacedSolid, Sphere, make_transform
from infomap_ros.motion.route import ArmPath
from infomap_ros.team.agents import Agent

RADIUS, SPEED, TICK = 0.4, 0.3, 0.1
BODY = PlacedSolid(Cylinder(RADIUS / np.sqrt(2.0), 0.5), np.eye(4), "body")
HAND, LENGTH = Sphere(0.1), 0.8
PATH = np.column_stack([np.linspace(0.0, 4.0, 9), np.zeros(9), np.zeros(9)])
MATE = Agent(
    2, 7, 1, 1, 0, np.eye(4), np.eye(4), None, PinholeCamera(64, 48, 45.0, 45.0, 31.5, 23.5), 4.0,
    radius=RADIUS,
)  # fmt: skip


class Stage:
    """A robot that drives at a constant speed, and a teammate whose place is told by a function."""

    def __init__(self, mate: Callable[[float], tuple[float, float]]) -> None:
        self.now, self.base, self._mate = 0.0, np.zeros(3), mate
        self.said: list[str] = []
        self.nearest = self.nearest_to_hand = np.inf
        self.angle, self.has_arm = 0.0, False
        self.covariance: np.ndarray | None = None
        around = Awareness(
            lambda: (self.base[0], self.base[1], self.base[2]),
            lambda: {"arm": self.angle},
            self._body,
            lambda: [replace(MATE, T_map_base=self._pose(), covariance=self.covariance)],
            lambda: self._pass(PAUSE),
            lambda state, _: self.said.append(state),
        )
        self.robot = KeepsClear(self, around)

    def drive(self, poses: np.ndarray, interrupted: Interrupted) -> Motion:
        path = [tuple(self.base)]
        for goal in poses:
            while (left := np.linalg.norm(goal - self.base)) > 1e-9:
                if interrupted():
                    return Motion("broken off", path)
                self.base = self.base + (goal - self.base) * min(1.0, SPEED * TICK / left)
                path.append(tuple(self.base))
                self._pass(TICK)
        return Motion("", path)

    def state(self) -> RobotState:
        return RobotState(np.eye(4), np.eye(4), np.eye(6), {"arm": self.angle})

    def look(self, interrupted: Interrupted) -> str:
        raise NotImplementedError

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        """The hand moves on a circle about the base."""
        since = 0.0
        while since < path.duration:
            if interrupted():
                return Motion("broken off")
            self._pass(TICK)
            since += TICK
            self.angle = float(np.interp(since, path.times, path.positions[:, 0]))
            there = LENGTH * np.array([np.cos(self.angle), np.sin(self.angle)])
            gap = np.linalg.norm(self._pose()[:2, 3] - there) - HAND.radius - RADIUS
            self.nearest_to_hand = min(self.nearest_to_hand, float(gap))
        return Motion("")

    def _body(self, joints: Mapping[str, float]) -> list[PlacedSolid]:
        turn = make_transform(Rotation.from_euler("z", joints["arm"]).as_matrix(), np.zeros(3))
        hand = turn @ make_transform(np.eye(3), (LENGTH, 0.0, 0.3))
        return [BODY, PlacedSolid(HAND, hand, "hand")] if self.has_arm else [BODY]

    def _pose(self) -> np.ndarray:
        pose = np.eye(4)
        pose[:2, 3] = self._mate(self.now)
        return pose

    def _pass(self, seconds: float) -> None:
        self.now += seconds
        gap = np.linalg.norm(self._pose()[:2, 3] - self.base[:2]) - 2 * RADIUS
        self.nearest = min(self.nearest, float(gap))


def crossing(now: float) -> tuple[float, float]:
    """Crosses the path in its middle when the robot would be there."""
    return 2.0, -2.0 + 0.3 * now


def test_it_lets_a_teammate_cross_and_then_drives_on_to_the_end() -> None:
    stage = Stage(crossing)
    motion = stage.robot.drive(PATH, lambda: False)
    assert motion.outcome == ""
    np.testing.assert_allclose(stage.base, PATH[-1], atol=1e-9)
    assert stage.said == ["waiting for teammates", "going on"]
    assert stage.nearest > 0.15
    steps = np.linalg.norm(np.diff(np.array(motion.path), axis=0), axis=1)
    assert steps.sum() == pytest.approx(4.0, abs=0.05)

    careless = Stage(crossing)
    careless.drive(PATH, lambda: False)
    assert careless.nearest < 0.0


def test_it_gives_the_path_up_where_a_teammate_stops_on_it() -> None:
    stage = Stage(lambda now: (2.0, -2.0 + min(0.5 * now, 2.0)))
    motion = stage.robot.drive(PATH, lambda: False)
    assert motion.outcome.startswith("robot 2 is in the way, 0.")
    assert stage.nearest > 0.15
    assert stage.said == ["waiting for teammates"]
    assert 15.0 < stage.now < 21.0


@pytest.mark.parametrize(
    "mate",
    [lambda _: (2.0, 0.9), lambda now: (-0.9 - 0.1 * now, 0.0), lambda now: (4.0 - 0.3 * now, 2.5)],
    ids=["planned around", "left behind", "passes by"],
)
def test_it_does_not_stop_for_others(mate: Callable[[float], tuple[float, float]]) -> None:
    stage = Stage(mate)
    assert stage.robot.drive(PATH, lambda: False).outcome == ""
    assert not stage.said


def test_who_asks_it_to_stop_need_not_wait_for_the_teammate() -> None:
    stage = Stage(lambda now: (2.0, -2.0 + min(0.5 * now, 2.0)))
    motion = stage.robot.drive(PATH, lambda: stage.now > 8.0)
    assert motion.outcome == "broken off"
    assert stage.now < 9.0


QUARTER = ArmPath(("arm",), np.linspace(0.0, np.pi / 2, 51)[:, None], np.linspace(0.0, 5.0, 51))


def with_arm(mate: Callable[[float], tuple[float, float]], angle: float = 0.0) -> Stage:
    stage = Stage(mate)
    stage.has_arm, stage.angle = True, angle
    return stage


def comes_and_goes(now: float) -> tuple[float, float]:
    """Comes to where the hand is about to be, stays for some seconds, and goes."""
    return 0.0, float(np.interp(now, [0.0, 2.0, 8.0, 10.0], [3.0, 1.35, 1.35, 3.0]))


def test_the_arm_stops_for_a_teammate_and_then_ends_its_motion() -> None:
    stage = with_arm(comes_and_goes)
    assert stage.robot.move_arm(QUARTER, lambda: False).outcome == ""
    assert stage.angle == pytest.approx(np.pi / 2)
    assert stage.said == ["waiting for teammates", "going on"]
    assert stage.nearest_to_hand > 0.15

    careless = with_arm(comes_and_goes)
    careless.move_arm(QUARTER, lambda: False)
    assert careless.nearest_to_hand < 0.1


def test_an_arm_does_not_begin_a_motion_that_ends_at_a_teammate() -> None:
    stage = with_arm(lambda _: (0.0, 1.35))
    outcome = stage.robot.move_arm(QUARTER, lambda: False).outcome
    assert outcome.startswith("robot 2 is in the way, 0.05 m")
    assert stage.angle == 0.0


@pytest.mark.parametrize("sigma", [0.0, 0.05])
def test_where_a_teammate_is_not_sure_it_counts_as_nearer(sigma: float) -> None:
    stage = with_arm(lambda _: (0.0, 1.6))
    stage.covariance = sigma**2 * np.eye(6)
    outcome = stage.robot.move_arm(QUARTER, lambda: False).outcome
    assert bool(outcome) == (sigma > 0.0)


def test_an_arm_may_come_away_from_a_teammate() -> None:
    stage = with_arm(lambda _: (0.0, 1.35), np.pi / 2)
    back = replace(QUARTER, positions=QUARTER.positions[::-1])
    assert stage.robot.move_arm(back, lambda: False).outcome == ""
    assert not stage.said


def test_what_is_left_of_a_path_begins_slowly_where_the_arm_is() -> None:
    rest = rest_of(QUARTER, {"arm": 0.8})
    assert rest.positions[0, 0] == 0.8
    assert rest.positions[-1, 0] == QUARTER.positions[-1, 0]
    speeds = np.diff(rest.positions[:, 0]) / np.diff(rest.times)
    assert speeds[0] < 0.5 * speeds[-1]
    np.testing.assert_allclose(speeds[-10:], np.pi / 2 / 5.0)
    assert rest_of(QUARTER, {"arm": 2.0}).positions.shape == (2, 1)
