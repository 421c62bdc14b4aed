"""When a motion of a robot that tells no results counts as done."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from infomap_ros.exploration.commanded_robot import CommandedRobot
from infomap_ros.exploration.robot import RobotState
from infomap_ros.geometry import make_transform
from infomap_ros.motion.route import ArmPath


class RollingLink:
    """A base that brakes over 0.2 m, and shows its true place a tenth of a second late."""

    reports_results, fused_scans = False, 0

    def __init__(self) -> None:
        self.time, self.x, self.speed = 0.0, 0.0, 0.0
        self.goal: np.ndarray | None = None
        self.history = [0.0, 0.0]

    def known_state(self, in_odometry: bool = False) -> RobotState:
        pose = make_transform(np.eye(3), (self.history[-2], 0.0, 0.0))
        return RobotState(pose, pose, np.zeros((6, 6)), {})

    def base_speed(self) -> float:
        return abs(self.history[-1] - self.history[-2]) / 0.1

    def joint_positions(self) -> dict[str, float]:
        return {}

    def joint_velocities(self) -> dict[str, float]:
        return {}

    def send_base_path(self, poses: np.ndarray, in_odometry: bool) -> str:
        self.goal = poses[-1]
        return "path"

    def result(self, motion: str) -> None:
        return None

    def wait_until(
        self, condition: Callable[[], bool], timeout: float, interrupted: Callable[[], bool]
    ) -> bool:
        end = self.time + timeout
        while not condition():
            if self.time > end or interrupted():
                return False
            left = 0.0 if self.goal is None else float(self.goal[0]) - self.x
            self.speed = min(0.25, max(left, 0.0) * 1.25)
            self.time, self.x = self.time + 0.1, self.x + 0.1 * self.speed
            self.history.append(self.x)
        return True


def test_a_base_that_rolls_by_its_goal_has_not_arrived() -> None:
    link = RollingLink()
    motion = CommandedRobot(link).drive(np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]), bool)
    assert motion.outcome == ""
    assert link.speed <= 0.025 and 0.97 < link.x <= 1.0
    assert abs(motion.path[-1][0] - link.x) < 0.03


def test_a_base_that_stops_before_its_goal_has_failed_and_is_told_to_stay() -> None:
    link = RollingLink()
    real = link.send_base_path
    sent: list[float] = []

    def half(poses: np.ndarray, in_odometry: bool) -> str:
        sent.append(float(poses[-1][0]))
        return real(0.5 * poses, in_odometry)

    link.send_base_path = half  # type: ignore[method-assign]
    motion = CommandedRobot(link).drive(np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]), bool)
    assert "stopped 0.5" in motion.outcome
    assert sent[0] == 1.0 and abs(sent[1] - 0.5) < 0.03


class SlowMap(RollingLink):
    """A map that fuses a scan each ten seconds, up to so many."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most

    @property
    def fused_scans(self) -> int:  # type: ignore[override]
        return min(int(self.time / 10.0), self.most)


def test_a_look_goes_on_while_scans_are_fused_however_slowly() -> None:
    link = SlowMap(most=10)
    assert CommandedRobot(link).look(bool) == ""
    assert link.time > 29.0
    assert "no new scan was fused within 15 s" in CommandedRobot(SlowMap(most=2)).look(bool)


class PressedArm(RollingLink):
    """An arm that is pressed beyond a stop of its joint, and does not come to its goal."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[ArmPath] = []

    def joint_positions(self) -> dict[str, float]:
        return {"slide": 0.1319, "lift": 0.5}

    def joint_velocities(self) -> dict[str, float]:
        return {"slide": 0.02, "lift": 0.1}

    def send_arm_path(self, path: ArmPath) -> str:
        self.sent.append(path)
        return "path"


def test_an_arm_that_is_stopped_is_sent_nowhere_that_its_path_does_not_go() -> None:
    link = PressedArm()
    knots = np.array([(0.13, 0.2), (0.0, 0.9)])
    path = ArmPath(("slide", "lift"), knots, np.array([0.0, 2.0]), True, "")
    assert "has stopped" in CommandedRobot(link).move_arm(path, bool).outcome
    assert link.sent[-1].positions[-1][0] == 0.13
    assert 0.5 < link.sent[-1].positions[-1][1] < 0.6
