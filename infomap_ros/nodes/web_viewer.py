"""Node ``web_viewer``: a page in a browser that shows the run of a robot while it goes on.

It shows what is there: the shared map from its updates, the robot where its description, joints
and pose are known, the camera, the views that were considered with their ratings and reasons, the
team. Buttons call the services of ``explorer``, and a box that is drawn goes out on ``interest``.
It only listens otherwise, needs no input, and its absence changes nothing.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import ExplorationError, InfomapError, MalformedMessageError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.messages import decode_pose
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.planning.plan_outputs import CANDIDATES, REJECTED
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig
from infomap_ros.nodes.team.map_listener import MapListener, MapListenerConfig
from infomap_ros.nodes.team.team_radio import TeamRadioConfig
from infomap_ros.nodes.team.team_topics import TeamIdentityConfig, listen_to_agents
from infomap_ros.team.agent_board import AgentBoard
from infomap_ros.team.config import TeamConfig
from infomap_ros.viewer import LivePage, PageConfig
from infomap_ros.viewer.run_panel import InterestBox, map_figures
from infomap_ros.viewer.views_layer import ConsideredView

_MARKERS = "visualization_msgs/msg/MarkerArray"
_SHARES = ("known fraction", "precise fraction")
_COUNTS = {"views": "views", "surface voxels": "surface voxels", "failures": "failed views"}


class PlanListener:
    """Listens to view_candidates, next_view, the planned path and exploration_status.

    Args:
        node: that listens.
        page: where they are shown.
        planner: name of the node that plans.
        camera: the camera whose views they are; None where it is not known yet.
    """

    def __init__(
        self,
        node: MonitoredNode,
        page: LivePage,
        planner: str,
        camera: Callable[[], PinholeCamera | None],
    ) -> None:
        self._page, self._camera = page, camera
        self._state = self._reason = ""
        inputs: tuple[tuple[type, str, Callable[[Any], None]], ...] = (
            (MarkerArray, "view_candidates", self._on_candidates),
            (PoseStamped, "next_view", self._on_view),
            (Path, f"{planner}/base_path", self._on_path),
            (DiagnosticStatus, "exploration_status", self._on_status),
        )
        for kind, topic, handle in inputs:
            node.listen(kind, topic, handle, qos.latched(), required=False)

    def _on_candidates(self, message: MarkerArray) -> None:
        self._page.views.show(considered_views(message))

    def _on_view(self, message: PoseStamped) -> None:
        view = decode_pose(message).transform
        self._page.views.show_chosen(view, self._camera(), self._reason)

    def _on_path(self, message: Path) -> None:
        places = [decode_pose(each).transform[:3, 3] for each in message.poses]
        self._page.views.show_path(np.array(places).reshape(-1, 3))

    def _on_status(self, message: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in message.values}
        self._page.panel.show_state(message.message, _figures(values))
        reason = values.get("last reason", "")
        if reason != self._reason:
            self._reason = reason
            self._page.views.show_reason(reason)
            self._page.panel.say(reason)
        if message.message != self._state:
            self._state = message.message
            self._page.panel.say(message.message)
            known, precise = (_number(values.get(name, "")) for name in _SHARES)
            self._page.panel.add_point(known, precise)


def considered_views(message: MarkerArray) -> list[ConsideredView]:
    """The views of view_candidates.

    Raises:
        MalformedMessageError: a marker is not an arrow between two different points.
    """
    return [
        _considered(marker)
        for marker in message.markers
        if marker.action == Marker.ADD and marker.ns in (CANDIDATES, REJECTED)
    ]


def _considered(marker: Marker) -> ConsideredView:
    ends = np.array([(point.x, point.y, point.z) for point in marker.points])
    length = float(np.linalg.norm(ends[-1] - ends[0])) if ends.shape == (2, 3) else math.nan
    if not length > 0.0 or not math.isfinite(length):
        raise MalformedMessageError(_MARKERS, f"{marker.ns}/{marker.id} is not an arrow")
    color = np.nan_to_num([marker.color.r, marker.color.g, marker.color.b])
    red, green, blue = (int(share) for share in np.rint(255.0 * np.clip(color, 0.0, 1.0)))
    direction = (ends[1] - ends[0]) / length
    rejected = marker.ns == REJECTED
    return ConsideredView(ends[0], direction, (red, green, blue), marker.text, rejected)


def _figures(values: dict[str, str]) -> dict[str, str]:
    """Of exploration_status, as the page shows them."""
    figures = {name: values[key] for key, name in _COUNTS.items() if key in values}
    figures |= {"distance": f"{values['distance [m]']} m"} if "distance [m]" in values else {}
    known, precise, sigma = (_number(values.get(key, "")) for key in (*_SHARES, "mean sigma [m]"))
    return figures | map_figures(known, precise, sigma)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


_FINDING = 2.0  # for which a service is looked for: it may just have come up [s]
_TIMEOUT = 30.0  # for which an answer is waited for: a busy explorer answers late [s]
_ORDERS = ("start", "pause", "resume", "home", "stop")


def exploration_orders(node: Node, explorer: str) -> dict[str, Callable[[], str]]:
    """What the services of an explorer do, by the labels of buttons.

    Args:
        node: whose executor runs in another thread than the orders are given in.
        explorer: name of the node that offers them.
    """
    clients = {name: node.create_client(Trigger, f"{explorer}/{name}") for name in _ORDERS}
    return {name.capitalize(): partial(_call, client) for name, client in clients.items()}


def _call(client: Client) -> str:
    """Call a service and wait for its answer.

    Raises:
        ExplorationError: nobody offers it or answers, or the answer is a refusal.
    """
    name = client.srv_name
    if not client.wait_for_service(_FINDING):
        raise ExplorationError(f"nobody offers the service {name}")
    done = threading.Event()
    answer: Future = client.call_async(Trigger.Request())
    answer.add_done_callback(lambda _: done.set())
    if not done.wait(_TIMEOUT):
        raise ExplorationError(f"{name} does not answer")
    response = answer.result()
    if not response.success:
        raise ExplorationError(response.message)
    return str(response.message)


_NAMESPACE = "web_viewer"


class InterestPublisher:
    """Publishes the box, or that it is gone.

    Args:
        node: that publishes.
        map_frame: in which the box is.
    """

    def __init__(self, node: MonitoredNode, map_frame: str) -> None:
        self._node, self._map_frame = node, map_frame
        self._publisher = node.advertise(MarkerArray, "interest", qos.latched())

    def publish(self, box: InterestBox | None) -> None:
        """Publish the box; None takes the last one away."""
        marker = Marker(ns=_NAMESPACE, id=0, type=Marker.CUBE)
        marker.header.frame_id = self._map_frame
        marker.header.stamp = self._node.get_clock().now().to_msg()
        marker.action = Marker.DELETE if box is None else Marker.ADD
        if box is not None:
            position, scale, color = marker.pose.position, marker.scale, marker.color
            position.x, position.y, position.z = box.center
            scale.x, scale.y, scale.z = box.size
            color.r, color.g, color.b, color.a = 0.8, 0.47, 0.65, 0.3
            marker.pose.orientation.w = 1.0
            marker.text = f"{box.weight:g}"
        self._publisher.publish(MarkerArray(markers=[marker]))


_PLACE_PERIOD = 0.2  # between two places of robot and camera [s]
_MAP_PERIOD = 1.0  # between two pictures of the map that changes [s]
_EXPLORER, _PLANNER = "explorer", "next_best_view"


class WebViewerNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (PageConfig, ""),
        (MapListenerConfig, ""),
        (TeamIdentityConfig, ""),
        (TeamConfig, "team_map."),
        (TeamRadioConfig, "team_map."),
        (RobotTrackerConfig, ""),
        (AssumedPoseConfig, ""),
        (JointBufferConfig, "joints."),
    )

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("web_viewer", **node_arguments)
        frame = self.config(RobotTrackerConfig).map_frame
        interest = InterestPublisher(self, frame)
        orders = exploration_orders(self, _EXPLORER)
        title = self.get_namespace().strip("/") or "infomap"
        self._page = LivePage(title, self.config(PageConfig), orders, interest.publish)
        self._tracker = RobotTracker(self, required=False)
        who = self.config(TeamIdentityConfig)
        self._board = AgentBoard(who.robot_id, None, who.team, who.read_key())
        listen_to_agents(self, frame, lambda text: self._board.receive(text, time.monotonic()))
        PlanListener(self, self._page, _PLANNER, self._camera)
        self._worker = self.start_worker(1)
        self._map = MapListener(self, self._worker, required=False, on_update=self._note_change)
        self._drawn, self._was_watched = float("-inf"), False
        self._has_changed = self._is_drawing = False
        self.repeat(_PLACE_PERIOD, self._show_places)
        self._address = self.advertise(String, "~/address", qos.latched())
        self._address.publish(String(data=self._page.address))
        self.get_logger().info(f"watch the run at {self._page.address}")

    def destroy_node(self) -> None:
        """End the page, then the node."""
        self._page.close()
        super().destroy_node()

    def _camera(self) -> PinholeCamera | None:
        try:
            return self._tracker.calibrations[0].rectified_camera()
        except InfomapError:
            return None

    def _note_change(self) -> None:
        self._has_changed = True

    def _show_places(self) -> None:
        """Show where everybody is, if anybody looks, and have the map drawn where it is due."""
        is_watched = self._page.is_watched
        is_new, self._was_watched = is_watched and not self._was_watched, is_watched
        if not is_watched:
            return
        now = time.monotonic()
        is_due = is_new or (self._has_changed and now - self._drawn > _MAP_PERIOD)
        if is_due and not self._is_drawing:
            self._has_changed, self._is_drawing, self._drawn = False, True, now
            self._worker.submit_always(self._draw_map)
        pose, state = self._tracker.newest_pose, self._tracker.known_state()
        if state is not None:
            self._page.robot.show(self._tracker.robot, state.T_map_base, state.joints)
            self._page.robot.show_camera(state.T_map_camera, self._camera())
        elif pose is not None:
            self._page.robot.show_camera(pose.transform, self._camera())
        self._board.origin = self._tracker.origin
        self._page.team.show(self._board.present(now))

    def _draw_map(self) -> None:
        self._is_drawing = False
        voxel_map = self._map.known_map()
        if voxel_map is not None:
            self._page.map.show(voxel_map)
            self.health.produced()


def main() -> int:
    """Run the node."""
    return run_node(WebViewerNode)


if __name__ == "__main__":
    raise SystemExit(main())
