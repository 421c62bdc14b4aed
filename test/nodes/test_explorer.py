"""The explorer across DDS: a robot on paper and a planner with one view stand at the other end."""

from __future__ import annotations

import json
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

from infomap_ros.errors import MalformedMessageError
from infomap_ros.exploration.records.choice_text import choice_to_text, route_digest
from infomap_ros.exploration.robot import Choice, MapProgress
from infomap_ros.geometry import make_transform
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.messages.commands import decode_arm_trajectory
from infomap_ros.motion.route import ArmPath, Route
from infomap_ros.nodes.explorer import ExplorerNode
from infomap_ros.nodes.locating.localization_status import status_message
from infomap_ros.nodes.planning.exploration_status import read_status
from infomap_ros.simulation.body.arm_motion import why_refused

from .rovers import PaperRover

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class OneView:
    """A next_best_view that always wants to go 1 m on, until the map is good enough."""

    def __init__(self, graph: Any, rover: PaperRover, views: int) -> None:
        self.rover, self.left, self.calls = rover, views, 0
        self.refuses = False
        self.routes: list[Route] = []
        graph.tester.create_service(Trigger, "next_best_view/plan", self.plan)
        self.asked: list[str] = []
        graph.tester.create_service(Trigger, "next_best_view/plan_arm", self.arm)
        for name in ("plan_home", "plan_back"):
            graph.tester.create_service(Trigger, f"next_best_view/{name}", partial(self.back, name))

    def arm(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        arm = ArmPath(
            ("arm_pan_joint", "arm_wrist_joint"),
            np.array([[0.1, 0.1], [0.2 + 0.1 * self.calls, 0.3]]),
            np.array([0.0, 0.5]),
        )
        still = ArmPath.staying(arm.joint_names, arm.positions[0])
        route = Route(still, np.zeros((0, 3)), np.zeros((0, 4, 4)), arm, np.eye(4))
        progress = MapProgress(0.5, 10.0, 0.01, 100, 1000, 0.5)
        choice = Choice(progress, np.eye(4), route, "")
        response.message, response.success = choice_to_text(choice), True
        return response

    def back(self, name: str, *call: Any) -> Trigger.Response:
        self.asked.append(name)
        self.rover.tells_updates = True
        return self.plan(*call)

    def plan(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.calls += 1
        if self.calls == 1 or self.refuses:
            response.message = "no map yet"
            return response
        x = float(self.rover.base[0, 3])
        path = np.array([[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0]])
        poses = np.stack([make_transform(np.eye(3), (px, 0.0, 0.0)) for px, _, _ in path])
        arm = ArmPath(
            ("arm_pan_joint", "arm_wrist_joint"),
            np.array([[0.1, 0.1], [0.2 + 0.1 * self.calls, 0.3]]),
            np.array([0.0, 0.5]),
        )
        still = ArmPath.staying(arm.joint_names, arm.positions[0])
        route = Route(still, path, poses, arm, np.eye(4))
        known = 0.99 if self.left == 0 else 0.5
        self.left -= 1
        self.routes.append(route)
        progress = MapProgress(known, 10.0, 0.01, 100, 1000, known)
        response.message = choice_to_text(
            Choice(progress, self.seen_from(route), route, "on we go")
        )
        response.success = True
        return response

    def seen_from(self, route: Route) -> np.ndarray:
        """Where the rover's camera is at the end of a route, shape (4, 4)."""
        arm = route.arm_after
        joints = {**self.rover.joints, **dict(zip(arm.joint_names, arm.positions[-1], strict=True))}
        camera = self.rover.model.forward_kinematics(joints, self.rover.model.camera_frame)
        return np.asarray(route.base_poses[-1] @ camera)


class Stage:
    """Explorer, rover, planner and what is said of them."""

    rover_kind: type[PaperRover] = PaperRover

    def __init__(
        self, graph: Any, folder: Path, views: int, sees: bool = True, **parameters: Any
    ) -> None:
        self.graph = graph
        self.rover = self.rover_kind(graph, tells_updates=sees)
        self.planner = OneView(graph, self.rover, views)
        self.said: list[DiagnosticStatus] = graph.collect(
            DiagnosticStatus, "exploration_status", LATCHED
        )
        self.node = graph.add(
            ExplorerNode,
            mission_file=str(folder / "mission.json"),
            log_file=str(folder / "run.jsonl"),
            **{"progress_timeout": 3.0, **parameters},
        )

    def state(self) -> str:
        return self.said[-1].message if self.said else ""

    def spin_to(self, state: str) -> None:
        self.graph.spin_until(lambda: self.state().startswith(state), f"{state}, is {self.state()}")

    def call(self, name: str) -> Trigger.Response:
        client = self.graph.tester.create_client(Trigger, f"explorer/{name}")
        self.graph.spin_until(client.service_is_ready, name)
        future = client.call_async(Trigger.Request())
        self.graph.spin_until(future.done, name)
        return future.result()


def test_mission_from_start_to_done(graph: Any, tmp_path: Path) -> None:
    stage = Stage(graph, tmp_path, views=2, autostart=True)
    stage.spin_to("ended: done")
    assert len(stage.rover.paths) == 2
    assert {message.header.stamp.sec for message in stage.rover.trajectories} == {0}
    assert stage.rover.base[0, 3] == pytest.approx(2.0)
    news = read_status(stage.said[-1])
    assert news.views == 3
    assert news.home.base == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert len(news.looks) == 3
    assert news.looks[-1, 0, 3] - news.looks[0, 0, 3] == pytest.approx(2.0, abs=0.1)
    kinds = [json.loads(line)["kind"] for line in (tmp_path / "run.jsonl").read_text().splitlines()]
    assert kinds[0] == "start" and kinds[-1] == "end"
    assert json.loads((tmp_path / "mission.json").read_text())["views"] == 3


def test_a_lost_camera_goes_back_to_the_last_look_and_not_home(graph: Any, tmp_path: Path) -> None:
    stage = Stage(graph, tmp_path, views=4, autostart=True)
    graph.spin_until(lambda: len(stage.rover.paths) == 2, "the second path")
    stage.rover.tells_updates = False
    stage.spin_to("ended: done")
    assert stage.planner.asked == ["plan_back"]
    news = [read_status(status) for status in stage.said]
    last = next(each.last_look for each in news if each.views == 2)
    assert last.base == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    assert set(last.joints) == set(stage.rover.joints)


class SearchStage(Stage):
    """A rover whose localization has not seen its target yet, and finds it in the last look."""

    gives_up, answers, calls = False, True, 0

    def __init__(self, graph: Any, folder: Path, looks: int) -> None:
        self.left = looks
        graph.tester.create_service(Trigger, "next_best_view/plan_search", self.plan_search)
        self.news = graph.tester.create_publisher(DiagnosticStatus, "localization_status", LATCHED)
        graph.tester.create_timer(0.1, self.tell)
        super().__init__(graph, folder, views=1, autostart=True, progress_timeout=10.0)
        self.rover.is_located = False

    def tell(self) -> None:
        if not hasattr(self, "rover"):
            return
        state = "tracking" if self.rover.is_located else "searching"
        stamp = self.rover.stamp
        self.news.publish(status_message(LocalizedCamera(stamp, state, None, None)))

    def plan_search(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """The base turns while the target is not in sight."""
        self.calls += 1
        if not self.answers:
            return response
        self.left -= 1
        still = ArmPath.staying(("arm_pan_joint",), np.array([0.1]))
        path = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
        route = Route(still, path, np.stack([np.eye(4)] * 2), still, np.eye(4))
        self.rover.is_located = self.left == 0 and not self.gives_up
        choice = Choice(MapProgress(0.0, 0.0, 0.0, 0, 0, 0.0), np.eye(4), route, "turn")
        if self.gives_up and self.left == 0:
            choice = Choice(choice.progress, None, None, "the target was not found: 2 looks")
        response.message, response.success = choice_to_text(choice), True
        return response


def test_a_target_out_of_sight_is_looked_for_before_the_mission(graph: Any, tmp_path: Path) -> None:
    stage = SearchStage(graph, tmp_path, looks=2)
    stage.spin_to("looking for the target")
    stage.spin_to("ended: done")
    frames = [path.header.frame_id for path in stage.rover.paths]
    assert frames[0] == "odom" and frames[-1] == "map"
    assert stage.left == 0


def test_a_target_that_is_not_found_ends_the_mission(graph: Any, tmp_path: Path) -> None:
    stage = SearchStage(graph, tmp_path, looks=2)
    stage.gives_up = True
    stage.spin_to("ended: failed")
    assert stage.said[-1].values[1].value == "the target was not found: 2 looks"


def test_path_that_is_not_driven_fails_and_is_reported(graph: Any, tmp_path: Path) -> None:
    stage = Stage(
        graph,
        tmp_path,
        views=9,
        autostart=True,
        progress_timeout=0.5,
        task__max_failures=2,
    )
    stage.rover.obeys = False
    stage.spin_to("ended: failed")
    assert "stopped 1.00 m" in stage.said[-1].values[1].value
    graph.spin_until(lambda: read_status(stage.said[-1]).failed_view is not None, "failed view")
    failed = read_status(stage.said[-1]).failed_view
    assert failed is not None and failed.reason.startswith("drive") and not failed.reached


def test_a_blocked_route_stops_the_robot_and_another_view_is_chosen(
    graph: Any, tmp_path: Path
) -> None:
    stage = Stage(graph, tmp_path, views=1, autostart=True, progress_timeout=60.0)
    stage.rover.obeys = False
    statuses = graph.tester.create_publisher(DiagnosticStatus, "route_status", LATCHED)
    graph.spin_until(lambda: len(stage.rover.paths) == 1, "a path")
    digest = route_digest(stage.planner.routes[-1])
    for name, reason in (("another", "of a route before"), (digest, "a box at (0.50, 0.00)")):
        assert len(stage.rover.paths) == 1
        statuses.publish(
            DiagnosticStatus(
                level=DiagnosticStatus.ERROR,
                message=reason,
                values=[KeyValue(key="route", value=name)],
            )
        )
    graph.spin_until(lambda: len(stage.rover.paths) == 2, "the order to stay")
    assert len(stage.rover.paths[-1].poses) == 1
    stage.rover.obeys = True
    stage.spin_to("ended: done")
    failed = read_status(stage.said[-1]).failed_view
    assert failed is not None and failed.reason == "drive: broken off: a box at (0.50, 0.00)"


def test_services_start_pause_resume_and_stop(graph: Any, tmp_path: Path) -> None:
    stage = Stage(graph, tmp_path, views=1000)
    assert not stage.call("pause").success
    assert stage.call("start").success
    assert not stage.call("start").success
    graph.spin_until(lambda: len(stage.rover.paths) > 0, "motion")
    assert stage.call("pause").success
    stage.spin_to("paused")
    driven = len(stage.rover.paths)
    assert stage.call("resume").success
    graph.spin_until(lambda: len(stage.rover.paths) > driven, "motion after resume")
    assert stage.call("stop").success
    stage.spin_to("ended: stopped")


def test_restarted_explorer_goes_on_with_its_mission(graph: Any, tmp_path: Path) -> None:
    mission = {"views": 7, "distance": 3.0, "seconds": 9.0}
    home = {"home_base": [1.0, 2.0, 0.0], "home_joints": {"arm_pan_joint": 0.5}}
    (tmp_path / "mission.json").write_text(json.dumps(mission | home))
    stage = Stage(graph, tmp_path, views=1, autostart=True, resume=True)
    stage.spin_to("ended: done")
    news = read_status(stage.said[-1])
    assert news.views == 9
    assert news.home.base == (1.0, 2.0, 0.0)


def test_plan_only_moves_nothing(graph: Any, tmp_path: Path) -> None:
    stage = Stage(graph, tmp_path, views=2, autostart=True, plan_only=True)
    stage.spin_to("ended: done")
    assert stage.rover.paths == []


def test_a_mission_is_stopped_while_a_plan_is_waited_for(graph: Any, tmp_path: Path) -> None:
    stage = Stage(graph, tmp_path, views=9, autostart=True)
    stage.planner.refuses = True
    graph.spin_until(lambda: stage.planner.calls > 1, "calls in vain")
    assert stage.call("stop").success
    stage.spin_to("ended: stopped")


def lose_the_pose(stage: Stage) -> None:
    """The robot's clock is set back, and its joints are silent since."""
    stage.rover.stamp -= 1_000_000_000_000
    stage.rover.has_joints = False
    stage.graph.spin_until(lambda: stage.node._tracker.known_state() is None, "loss of the pose")


@pytest.mark.parametrize("order", ["stop", "end of the node"])
@pytest.mark.parametrize("state", ["looking", "driving", "paused", "choosing"])
def test_a_lost_pose_delays_no_stop(graph: Any, tmp_path: Path, state: str, order: str) -> None:
    stage = Stage(graph, tmp_path, views=9, autostart=True, progress_timeout=600.0)
    stage.rover.stamp += 2_000_000_000_000
    if state == "looking":
        graph.spin_until(lambda: stage.rover.paths, "a path")
        stage.rover.tells_updates = False
        stage.spin_to("looking")
    elif state == "driving":
        stage.rover.obeys = False
        graph.spin_until(lambda: stage.rover.paths, "a path")
    elif state == "paused":
        graph.spin_until(lambda: stage.rover.paths, "a path")
        assert stage.call("pause").success
        stage.spin_to("paused")
    else:
        stage.planner.refuses = True
        graph.spin_until(lambda: stage.planner.calls > 1, "calls in vain")
    lose_the_pose(stage)
    paths = len(stage.rover.paths)
    begin = time.monotonic()
    if order == "stop":
        assert stage.call("stop").success
        stage.spin_to("ended: stopped")
    else:
        stage.node.destroy_node()
        assert not stage.node._running
    assert time.monotonic() - begin < 4.0  # 1 s on a machine with nothing else to do
    if state == "driving":
        graph.spin_until(lambda: len(stage.rover.paths) > paths, "the order to stay")
        assert len(stage.rover.paths[-1].poses) == 1


def test_a_base_is_stopped_when_its_pose_is_lost_for_good(graph: Any, tmp_path: Path) -> None:
    stage = Stage(graph, tmp_path, views=9, autostart=True)
    stage.rover.stamp += 2_000_000_000_000
    stage.rover.obeys = False
    graph.spin_until(lambda: stage.rover.paths, "a path")
    lose_the_pose(stage)
    graph.spin_until(lambda: len(stage.rover.paths) > 1, "the order to stay")
    assert len(stage.rover.paths[-1].poses) == 1
    stage.spin_to("ended: failed")
    assert "joint" in said_last(stage)


def test_a_search_is_stopped_while_its_plan_is_waited_for(graph: Any, tmp_path: Path) -> None:
    stage = SearchStage(graph, tmp_path, looks=2)
    stage.answers = False
    graph.spin_until(lambda: stage.calls > 1, "calls in vain")
    assert stage.call("stop").success
    stage.spin_to("ended: stopped")


def test_an_explorer_that_ends_stops_the_base(graph: Any, tmp_path: Path) -> None:
    stage = Stage(graph, tmp_path, views=9, autostart=True)
    stage.rover.obeys = False
    graph.spin_until(lambda: len(stage.rover.paths) == 1, "a path")
    stage.node.destroy_node()
    graph.spin_until(lambda: len(stage.rover.paths) == 2, "the order to stay")
    (stay,) = stage.rover.paths[-1].poses
    assert (stay.pose.position.x, stay.pose.position.y) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_order_that_stops_the_arm_is_one_that_controllers_accept(
    graph: Any, tmp_path: Path
) -> None:
    stage = Stage(graph, tmp_path, views=9, autostart=True, progress_timeout=60.0)
    stage.rover.moves_arm = False
    graph.spin_until(lambda: len(stage.rover.trajectories) == 1, "a motion of the arm")
    assert stage.call("pause").success
    graph.spin_until(lambda: len(stage.rover.trajectories) == 2, "the order to stop")
    stop = decode_arm_trajectory(stage.rover.trajectories[-1])
    now = graph.tester.get_clock().now().nanoseconds
    assert why_refused(stop, stop.names, now) == ""
    assert 0.1 <= stop.times[-1] <= 0.5


def test_a_mission_waits_for_what_it_needs(graph: Any, tmp_path: Path) -> None:
    """While the others still compile their kernels, nothing has failed."""
    stage = Stage(graph, tmp_path, views=0, sees=False, autostart=True, progress_timeout=0.5)
    graph.spin_until(lambda: "waiting for map_updates" in said_last(stage), "the wait to be said")
    assert stage.state() == "starting"
    stage.rover.tells_updates = True
    stage.spin_to("ended: done")


def test_an_explorer_that_waits_for_a_robot_has_ended_when_it_is_gone(
    graph: Any, tmp_path: Path
) -> None:
    log = tmp_path / "run.jsonl"
    node = graph.add(
        ExplorerNode, autostart=True, mission_file=str(tmp_path / "m.json"), log_file=str(log)
    )
    said = graph.collect(DiagnosticStatus, "exploration_status", LATCHED)
    graph.spin_until(lambda: bool(said), "the exploration")
    begin = time.monotonic()
    node.destroy_node()
    assert time.monotonic() - begin < 1.0
    assert [json.loads(line)["reason"] for line in log.read_text().splitlines()] == ["stopped"]


def said_last(stage: Stage) -> str:
    values = {pair.key: pair.value for pair in stage.said[-1].values} if stage.said else {}
    return str(values.get("last reason", ""))


@pytest.mark.parametrize(
    "values", [{}, {"views": "1"}, {"views": "x", "home base": "[]", "home joints": "{}"}]
)
def test_foreign_status_is_refused(values: dict[str, str]) -> None:
    message = DiagnosticStatus(values=[KeyValue(key=k, value=v) for k, v in values.items()])
    with pytest.raises(MalformedMessageError, match="exploration status"):
        read_status(message)
