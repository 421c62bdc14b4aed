"""The node web_viewer: what the graph tells is on its page, and its buttons reach the graph."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.nodes.common import qos
from infomap_ros.nodes.next_best_view import Interests
from infomap_ros.nodes.web_viewer import WebViewerNode

from .rovers import PaperRover, update_messages


class Stage:
    """A rover, what its planner and explorer would tell, and a browser at the page."""

    def __init__(self, graph: Any, window: Any) -> None:
        self.graph, self.browser = graph, window
        self.rover = PaperRover(graph, tells_updates=False)
        self.orders: list[str] = []
        for name in ("start", "stop"):
            graph.tester.create_service(Trigger, f"explorer/{name}", self.serve(name))
        latched = qos.latched()
        tester = graph.tester
        self.candidates = tester.create_publisher(MarkerArray, "view_candidates", latched)
        self.view = tester.create_publisher(PoseStamped, "next_view", latched)
        self.path = tester.create_publisher(Path, "next_best_view/base_path", latched)
        self.status = tester.create_publisher(DiagnosticStatus, "exploration_status", latched)
        self.boxes = graph.collect(MarkerArray, "interest", latched)
        self.addresses = graph.collect(String, "web_viewer/address", latched)
        self.node = graph.add(WebViewerNode)
        graph.spin_until(lambda: self.addresses, "the address")

    def serve(self, name: str) -> Any:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            self.orders.append(name)
            response.success, response.message = name == "start", f"asked to {name}"
            return response

        return answer

    def open(self) -> None:
        self.browser.complaints.clear()
        self.browser.send("Page.navigate", url=self.addresses[-1].data)
        self.wait_for_text("Why this view")

    def text(self) -> str:
        return str(self.browser.evaluate("document.body?.innerText ?? ''"))

    def wait_for_text(self, text: str) -> None:
        self.graph.spin_until(lambda: text in self.text(), f"'{text}' on the page", 60.0)

    def click(self, label: str) -> None:
        self.browser.evaluate(
            "[...document.querySelectorAll('button')]"
            f".find(button => button.innerText === {label!r}).click()"
        )


@pytest.fixture
def stage(graph: Any, window: Any) -> Stage:
    return Stage(graph, window)


def arrow(kind: str, number: int, text: str, length: float = 0.1) -> Marker:
    marker = Marker(ns=kind, id=number, type=Marker.ARROW, action=Marker.ADD, text=text)
    marker.points = [Point(x=0.1 * number), Point(x=0.1 * number, y=length)]
    return marker


def test_what_is_planned_and_done_is_told(stage: Stage) -> None:
    stage.open()
    stage.candidates.publish(
        MarkerArray(
            markers=[
                Marker(action=Marker.DELETEALL),
                arrow("candidates", 0, "rating 2.5: information 9,000"),
                arrow("rejected", 1, "base path: too steep"),
                arrow("chosen", 0, ""),
            ]
        )
    )
    values = {"last reason": "tells most", "views": "4", "known fraction": "0.5"}
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    stage.status.publish(DiagnosticStatus(message="choosing", values=pairs))
    view = PoseStamped()
    view.pose.orientation.w = 1.0
    stage.view.publish(view)
    stage.path.publish(Path(poses=[view, view]))

    for text in ("1 views rated, 1 rejected", "rating 2.5: information 9,000", "1 x base path",
                 "tells most", "choosing", "50.0%"):  # fmt: skip
        stage.wait_for_text(text)
    assert not [text for text in stage.browser.complaints if "deprecated" not in text]


def test_an_arrow_without_a_length_is_a_counted_drop(stage: Stage) -> None:
    stage.candidates.publish(MarkerArray(markers=[arrow("candidates", 0, "rating 1", 0.0)]))

    stage.graph.spin_until(
        lambda: stage.node.health.values().get("dropped: malformed message") == "1", "the drop"
    )


def test_the_map_is_drawn_as_soon_as_somebody_looks(stage: Stage) -> None:
    voxel_map = stage.rover.looks(0.0, 0.8)
    for message in update_messages(voxel_map):
        stage.rover.updates.publish(message)
    stage.open()

    stage.graph.spin_until(lambda: stage.node.health.values()["results"] != "0", "a drawn map")


def test_buttons_reach_the_explorer(stage: Stage) -> None:
    stage.open()
    stage.click("Start")
    stage.wait_for_text("Start: asked to start")
    stage.click("Stop")
    stage.wait_for_text("Stop: asked to stop")
    stage.click("Home")  # which nobody offers
    stage.wait_for_text("nobody offers the service")

    assert stage.orders == ["start", "stop"]


def test_a_box_is_a_place_of_interest_to_the_planner(stage: Stage) -> None:
    stage.open()
    stage.browser.evaluate(
        "document.evaluate(\"//*[contains(text(), 'Place of interest')]\", document, null, 9, null)"
        ".singleNodeValue.click()"
    )
    stage.wait_for_text("Place a box")
    planner = Interests("map")

    stage.click("Send")
    stage.graph.spin_until(lambda: stage.boxes, "the box")
    planner.update(stage.boxes[-1])
    (interest,) = planner.current()
    stage.click("Remove")
    stage.graph.spin_until(lambda: len(stage.boxes) == 2, "its end")
    planner.update(stage.boxes[-1])

    assert interest.weight == 3.0
    assert np.allclose(interest.place.transform[:3, 3], 0.0)
    assert planner.current() == ()


def test_without_anything_to_hear_it_complains_of_nothing(stage: Stage) -> None:
    assert stage.node.health.newly_missing()[0] == []
