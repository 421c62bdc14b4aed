"""A robot stops for a teammate that comes its way, and drives on when it has gone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from infomap_ros.exploration.robot import Interrupted, Motion, RobotState
from infomap_ros.exploration.team.keep_clear import (
    PAUSE,
    KeepClearConfig,
    KeepsClear,
    Surroundings,
)
from infomap_ros.geometry import PinholeCamera
from infomap_ros.motion.route import ArmPath
from infomap_ros.team.agents import Agent

RADIUS, SPEED, TICK = 0.4, 0.3, 0.1
WAY = np.column_stack([np.linspace(0.0, 4.0, 9), np.zeros(9), np.zeros(9)])
MATE = Agent(
    2, 7, 1, 1, 0, np.eye(4), np.eye(4), None, PinholeCamera(64, 48, 45.0, 45.0, 31.5, 23.5), 4.0,
    radius=RADIUS,
)  # fmt: skip


class Stage:
    """A robot that drives at a constant speed, and a teammate whose place is told by a function."""

    def __init__(self, mate: Callable[[float], tuple[float, float]]) -> None:
        self.now, self.base, self._mate = 0.0, np.zeros(3), mate
        self.said: list[str] = []
        self.nearest = np.inf
        around = Surroundings(
            lambda: (self.base[0], self.base[1], self.base[2]),
            lambda: RADIUS,
            lambda: [replace(MATE, T_map_base=self._pose())],
            lambda: self._pass(PAUSE),
            lambda state, _: self.said.append(state),
        )
        self.robot = KeepsClear(self, around, KeepClearConfig(patience=10.0))

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
        raise NotImplementedError

    def look(self, interrupted: Interrupted) -> str:
        raise NotImplementedError

    def move_arm(self, path: ArmPath, interrupted: Interrupted) -> Motion:
        raise NotImplementedError

    def _pose(self) -> np.ndarray:
        pose = np.eye(4)
        pose[:2, 3] = self._mate(self.now)
        return pose

    def _pass(self, seconds: float) -> None:
        self.now += seconds
        gap = np.linalg.norm(self._pose()[:2, 3] - self.base[:2]) - 2 * RADIUS
        self.nearest = min(self.nearest, float(gap))


def crossing(now: float) -> tuple[float, float]:
    """Crosses the way in its middle when the robot would be there."""
    return 2.0, -2.0 + 0.3 * now


def test_it_lets_a_teammate_cross_and_then_drives_on_to_the_end() -> None:
    stage = Stage(crossing)
    motion = stage.robot.drive(WAY, lambda: False)
    assert motion.outcome == ""
    np.testing.assert_allclose(stage.base, WAY[-1], atol=1e-9)
    assert stage.said == ["waiting for teammates", "driving on"]
    assert stage.nearest > 0.15
    steps = np.linalg.norm(np.diff(np.array(motion.path), axis=0), axis=1)
    assert steps.sum() == pytest.approx(4.0, abs=0.05)

    careless = Stage(crossing)
    careless.drive(WAY, lambda: False)
    assert careless.nearest < 0.0


def test_it_gives_the_way_up_where_a_teammate_stops_in_it() -> None:
    stage = Stage(lambda now: (2.0, -2.0 + min(0.5 * now, 2.0)))
    motion = stage.robot.drive(WAY, lambda: False)
    assert motion.outcome.startswith("robot 2 is in the way, 0.")
    assert stage.nearest > 0.15
    assert stage.said == ["waiting for teammates"]
    assert 10.0 < stage.now < 16.0


@pytest.mark.parametrize(
    "mate",
    [lambda _: (2.0, 0.9), lambda now: (-0.9 - 0.1 * now, 0.0), lambda now: (4.0 - 0.3 * now, 2.5)],
    ids=["planned around", "left behind", "passes by"],
)
def test_it_does_not_stop_for_others(mate: Callable[[float], tuple[float, float]]) -> None:
    stage = Stage(mate)
    assert stage.robot.drive(WAY, lambda: False).outcome == ""
    assert not stage.said


def test_who_asks_it_to_stop_need_not_wait_for_the_teammate() -> None:
    stage = Stage(lambda now: (2.0, -2.0 + min(0.5 * now, 2.0)))
    motion = stage.robot.drive(WAY, lambda: stage.now > 8.0)
    assert motion.outcome == "broken off"
    assert stage.now < 9.0
