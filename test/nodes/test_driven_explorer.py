"""The explorer through robot_driver: controllers on paper that keep the rules of the real ones."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from infomap_ros.geometry import make_transform
from infomap_ros.messages.commands import decode_arm_trajectory
from infomap_ros.nodes.planning.exploration_status import read_status
from infomap_ros.nodes.robot_driver import RobotDriverNode
from infomap_ros.simulation.body.arm_motion import why_refused

from .controllers import PathController, TrajectoryController
from .rovers import PaperRover
from .test_explorer import Stage

pytestmark = pytest.mark.skipif(
    find_spec("control_msgs") is None or find_spec("nav2_msgs") is None,
    reason="control_msgs and nav2_msgs: python -m infomap_ros.nodes.common.message_packages",
)


class DrivenRover(PaperRover):
    """Moves by its controllers and their actions; what is commanded on topics it only notes."""

    def __init__(self, graph: Any, **settings: Any) -> None:
        super().__init__(graph, **settings)
        joints = {name: 0.1 for name in self.joints if name.startswith("arm_")}
        self.arm = TrajectoryController(graph, "arm_controller", joints, publishes=False)
        self.nav2 = PathController(graph)
        self.nav2.SPEED = 4.0
        table = f"arm_controller: {', '.join(joints)}"
        self.driver = graph.add(RobotDriverNode, controllers=[table])
        graph.tester.create_timer(0.02, self.follow)

    def follow(self) -> None:
        self.joints |= self.arm.joints
        self.base = make_transform(self.base[:3, :3], (*self.nav2.base[:2], 0.0))

    def on_path(self, message: Any) -> None:
        self.paths.append(message)

    def on_arm(self, message: Any) -> None:
        self.trajectories.append(message)


class DrivenStage(Stage):
    rover_kind = DrivenRover


@pytest.fixture
def stage(graph: Any, tmp_path: Path) -> DrivenStage:
    return DrivenStage(graph, tmp_path, views=2, progress_timeout=10.0)


def failure(stage: DrivenStage) -> str:
    """Why the last view brought nothing, once that is known."""
    stage.graph.spin_until(
        lambda: stage.said and read_status(stage.said[-1]).failed_view, "a failed view"
    )
    view = read_status(stage.said[-1]).failed_view
    assert view is not None
    return view.reason


def test_a_mission_goes_through_the_controllers_to_its_end(stage: DrivenStage) -> None:
    assert stage.call("start").success
    stage.spin_to("ended: done")
    rover = stage.rover
    assert not rover.arm.refused
    assert len(rover.nav2.goals) == 2
    assert len(rover.arm.goals) == 2
    assert rover.nav2.base[0] == pytest.approx(2.0)
    assert read_status(stage.said[-1]).views == 3


def test_an_abort_is_known_at_once_and_in_the_words_of_the_controller(stage: DrivenStage) -> None:
    stage.rover.nav2.blocked = True
    assert stage.call("start").success
    stage.graph.spin_until(lambda: stage.rover.nav2.goals, "a goal")
    reason = failure(stage)
    assert "FAILED_TO_MAKE_PROGRESS (105): Failed to make progress" in reason
    assert stage.rover.arm.goals == []


def test_an_arm_that_sticks_is_quoted(stage: DrivenStage) -> None:
    stage.rover.arm.stuck.add("arm_wrist_joint")
    stage.rover.driver._drivers[0]._carrier._time = 0.3
    assert stage.call("start").success
    assert "GOAL_TOLERANCE_VIOLATED (-5): joint arm_wrist_joint is" in failure(stage)


@pytest.mark.parametrize("order", ["pause", "stop"])
def test_a_pause_and_a_stop_cancel_the_drive(stage: DrivenStage, order: str) -> None:
    stage.rover.nav2.SPEED = 0.1
    assert stage.call("start").success
    stage.graph.spin_until(lambda: stage.rover.nav2.base[0] > 0.05, "motion")
    assert stage.call(order).success
    stage.graph.spin_until(lambda: stage.rover.nav2.canceled == 1, "cancel")
    stage.spin_to("paused" if order == "pause" else "ended: stopped")
    assert stage.rover.nav2.base[0] < 0.9


@pytest.mark.parametrize("order", ["pause", "stop"])
def test_a_pause_and_a_stop_halt_the_arm(stage: DrivenStage, order: str) -> None:
    stage.rover.arm.slower = 20.0
    assert stage.call("start").success
    arm = stage.rover.arm
    stage.graph.spin_until(lambda: arm.joints["arm_wrist_joint"] > 0.105, "motion")
    arm.slower = 1.0
    assert stage.call(order).success
    stage.spin_to("paused" if order == "pause" else "ended: stopped")
    stage.graph.spin_until(lambda: not arm.moves, "stop", timeout=2.0)
    assert arm.joints["arm_wrist_joint"] < 0.25
    assert not arm.refused
    stop = decode_arm_trajectory(stage.rover.trajectories[-1])
    assert 0.1 <= stop.times[-1] <= 0.5
    now = stage.graph.tester.get_clock().now().nanoseconds
    assert why_refused(stop, tuple(arm.joints), now, allow_partial=True) == ""


def test_a_server_that_goes_is_named(stage: DrivenStage) -> None:
    stage.rover.nav2.SPEED = 0.1
    assert stage.call("start").success
    stage.graph.spin_until(lambda: stage.rover.nav2.base[0] > 0.05, "motion")
    stage.rover.nav2.server.destroy()
    assert "follow_path: its action server has gone" in failure(stage)
