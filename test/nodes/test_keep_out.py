"""Where the base must not go, over topics: what is taken, what is refused, and what it stops."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Point32, PolygonStamped
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import ConfigError, FrameError, MalformedMessageError
from infomap_ros.exploration.records.choice_text import route_digest
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.parameters import declare_config
from infomap_ros.nodes.explorer import ExplorerNode
from infomap_ros.nodes.planning.exploration_status import read_status
from infomap_ros.nodes.planning.keep_out_listener import KeepOutListener

from .rovers import update_messages
from .test_next_best_view import Stage
from .test_route_check import room

NAN = float("nan")


def box(number: int = 1, place: Sequence[float] = (2.0, 0.0), sides: float = 1.0) -> Marker:
    made = Marker(ns="site", id=number, type=Marker.CUBE)
    made.header.frame_id = "map"
    made.pose.position.x, made.pose.position.y = (float(value) for value in place)
    made.pose.orientation.w = 1.0
    made.scale.x = made.scale.y = made.scale.z = sides
    return made


def strip(*corners: tuple[float, float], number: int = 2) -> Marker:
    made = Marker(ns="site", id=number, type=Marker.LINE_STRIP)
    made.header.frame_id = "map"
    made.pose.orientation.w = 1.0
    made.points = [Point(x=float(x), y=float(y)) for x, y in corners]
    return made


def fence(*corners: tuple[float, float], frame: str = "map") -> PolygonStamped:
    made = PolygonStamped()
    made.header.frame_id = frame
    made.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
    return made


SQUARE = ((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0))


@pytest.fixture
def changes() -> list[int]:
    return []


@pytest.fixture
def listener(graph: Any, changes: list[int]) -> KeepOutListener:
    node = graph.add(MonitoredNode, "listener")
    made = KeepOutListener(node, "map", lambda: changes.append(1))
    made.set_regions(MarkerArray(markers=[box(), strip((0, 2), (1, 2), (1, 3))]))
    made.set_fence(fence(*SQUARE))
    return made


def test_boxes_polygons_and_the_fence_are_where_they_were_put(
    listener: KeepOutListener, changes: list[int]
) -> None:
    turned = box(3, (0.0, -2.0))
    turned.pose.orientation.z = turned.pose.orientation.w = np.sqrt(0.5)
    turned.scale.y = 0.2  # along x, after a quarter turn
    listener.set_regions(MarkerArray(markers=[turned]))
    first, second, third = listener.current().regions
    assert (first.name, second.name, third.name) == ("site/1", "site/2", "site/3")
    points = [[2.4, 0.4], [0.9, 2.2], [0.05, -1.6], [0.3, -2.0]]
    inside = [(each.signed_distance(points) < 0.0).tolist() for each in (first, second, third)]
    assert inside == [[True, False, False, False], [False, True, False, False],
                      [False, False, True, False]]  # fmt: skip
    (yard,) = listener.current().fences
    assert yard.corners == SQUARE
    assert len(changes) == 3


def test_markers_replace_and_delete_and_an_empty_fence_is_none(listener: KeepOutListener) -> None:
    listener.set_regions(MarkerArray(markers=[box(1, (9.0, 9.0))]))
    assert listener.current().regions[0].signed_distance((9.0, 9.0)) < 0.0
    listener.set_regions(MarkerArray(markers=[Marker(ns="site", id=2, action=Marker.DELETE)]))
    assert [each.name for each in listener.current().regions] == ["site/1"]
    listener.set_regions(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
    listener.set_fence(PolygonStamped())
    assert listener.current().regions == listener.current().fences == ()


def _nan(made: Marker) -> None:
    made.pose.position.x = NAN


def _flat(made: Marker) -> None:
    made.scale.y = 0.0


def _endless(made: Marker) -> None:
    made.scale.x = float("inf")


def _sphere(made: Marker) -> None:
    made.type = Marker.SPHERE


def _tilted(made: Marker) -> None:
    made.pose.orientation.x = made.pose.orientation.w = np.sqrt(0.5)


def _unturned(made: Marker) -> None:
    made.pose.orientation.w = 0.0


def _corners(*corners: tuple[float, float]) -> Callable[[Marker], None]:
    def spoil(made: Marker) -> None:
        made.type, made.points = Marker.LINE_STRIP, strip(*corners).points

    return spoil


CROSSING = ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0))


@pytest.mark.parametrize(
    "spoil",
    [
        _nan, _flat, _endless, _sphere, _tilted, _unturned, _corners((0, 0), (1, 1)), _corners(),
        _corners((0, 0), (1, 0), (1, NAN)), _corners(*CROSSING),
    ],
)  # fmt: skip
def test_a_bad_region_is_refused_by_name_and_the_old_ones_stay(
    listener: KeepOutListener, changes: list[int], spoil: Callable[[Marker], None]
) -> None:
    before, bad = listener.current(), box(9)
    spoil(bad)
    with pytest.raises(MalformedMessageError, match="site/9"):
        listener.set_regions(MarkerArray(markers=[box(8), bad]))
    assert listener.current() == before
    assert len(changes) == 2


@pytest.mark.parametrize("corners", [CROSSING, SQUARE[:2], (*SQUARE[:2], (NAN, 1.0))])
def test_a_bad_fence_is_refused_and_the_old_one_stays(
    listener: KeepOutListener, corners: tuple[tuple[float, float], ...]
) -> None:
    before = listener.current()
    with pytest.raises(MalformedMessageError, match="geofence"):
        listener.set_fence(fence(*corners))
    assert listener.current() == before


def test_another_frame_is_refused(listener: KeepOutListener) -> None:
    before, other = listener.current(), box(5)
    other.header.frame_id = "odom"
    with pytest.raises(FrameError, match="keep_out in frame 'odom'"):
        listener.set_regions(MarkerArray(markers=[other]))
    with pytest.raises(FrameError, match="geofence in frame 'odom'"):
        listener.set_fence(fence(*SQUARE, frame="odom"))
    assert listener.current() == before


def test_a_node_is_started_with_regions_and_refuses_what_is_none(graph: Any) -> None:
    given = {"task__keep_out": ["stairs: 1 0 2 0 2 1"], "task__geofence": [-3, -3, 3, -3, 3, 3]}
    task = declare_config(graph.add(Node, "good", **given), TaskConfig, "task.")
    (stairs,) = task.rules.regions
    assert stairs.name == "stairs"
    assert stairs.corners == ((1.0, 0.0), (2.0, 0.0), (2.0, 1.0))
    assert len(task.rules.fences) == 1
    node = graph.add(Node, "bad", task__keep_out=["stairs: 1 0 2 0"])
    with pytest.raises(ConfigError, match=r"'task.keep_out'.*2 corners"):
        declare_config(node, TaskConfig, "task.")


def test_a_refused_message_is_counted_and_what_was_set_stays(graph: Any) -> None:
    node = graph.add(MonitoredNode, "listener")
    listener = KeepOutListener(node, "map", lambda: None)
    regions = graph.tester.create_publisher(MarkerArray, "keep_out", qos.latched())
    regions.publish(MarkerArray(markers=[box()]))
    graph.spin_until(lambda: listener.current().regions, "the region")
    bad = box(7)
    bad.pose.position.y = NAN
    regions.publish(MarkerArray(markers=[bad]))
    graph.spin_until(lambda: node.health.drops(), "the refusal")
    assert node.health.drops() == {"malformed message": 1}
    assert [each.name for each in listener.current().regions] == ["site/1"]


def test_a_region_across_the_way_stops_the_robot_with_the_reason(
    graph: Any, tmp_path: Path
) -> None:
    stage = Stage(graph)
    stage.rover.obeys = False  # the base never gets to the end of its way
    states = graph.collect(DiagnosticStatus, "route_status", qos.latched())
    said = graph.collect(DiagnosticStatus, "exploration_status", qos.latched())
    regions = graph.tester.create_publisher(MarkerArray, "keep_out", qos.latched())
    for message in update_messages(room(stage.rover)):
        stage.rover.updates.publish(message)
    stage.rover.tells_updates = True
    graph.add(
        ExplorerNode,
        autostart=True,
        progress_timeout=60.0,
        mission_file=str(tmp_path / "mission.json"),
        log_file=str(tmp_path / "run.jsonl"),
    )
    graph.spin_until(lambda: stage.rover.paths, "a path of the base", timeout=90.0)
    sent = stage.node._planner.planner.motion._sent
    assert sent is not None and sent.moves_base

    regions.publish(MarkerArray(markers=[box(1, sent.base_path[-1, :2], 0.3)]))

    graph.spin_until(lambda: states[-1].level == DiagnosticStatus.ERROR, "the route to be blocked")
    assert states[-1].values[0].value == route_digest(sent)
    assert states[-1].message.startswith("the base path is blocked at (")
    assert states[-1].message.endswith(
        "the base would stand in or next to keep-out region 'site/1'"
    )
    graph.spin_until(lambda: len(stage.rover.paths) > 1, "the order to stay")

    def failed() -> str:
        view = read_status(said[-1]).failed_view if said else None
        return "" if view is None else view.reason

    graph.spin_until(failed, "the failed view")
    assert failed().startswith("drive: broken off: the base path is blocked at (")
