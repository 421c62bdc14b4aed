"""Node ``web_viewer``: a page in a browser that shows the run of a robot while it goes on.

It shows what is there: the shared map from its updates, the robot where its description, joints
and pose are known, the camera, the views that were considered with their ratings and reasons, the
team. Buttons call the services of ``explorer``, and a box that is drawn goes out on ``interest``.
It only listens otherwise, needs no input, and its absence changes nothing.
"""

from __future__ import annotations

import time
from typing import Any

from rclpy.clock import Clock, ClockType
from std_msgs.msg import String

from infomap_ros.errors import InfomapError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig
from infomap_ros.nodes.team.agents_topic import listen_to_agents
from infomap_ros.nodes.team.map_listener import MapListener, MapListenerConfig
from infomap_ros.nodes.team.team_identity import TeamIdentityConfig
from infomap_ros.nodes.team.team_radio import TeamRadioConfig
from infomap_ros.nodes.viewing.interest_publisher import InterestPublisher
from infomap_ros.nodes.viewing.orders import exploration_orders
from infomap_ros.nodes.viewing.plan_listener import PlanListener
from infomap_ros.team import TeamConfig
from infomap_ros.team.agent_board import AgentBoard
from infomap_ros.team.agents_config import AgentBoardConfig
from infomap_ros.viewer import LivePage, PageConfig

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
        (AgentBoardConfig, "agents."),
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
        memory = self.config(AgentBoardConfig)
        self._board = AgentBoard(who.robot_id, None, memory, who.team, who.read_key())
        listen_to_agents(self, frame, self._hear)
        PlanListener(self, self._page, _PLANNER, self._camera)
        self._worker = self.start_worker(1)
        self._map = MapListener(self, self._worker, required=False, on_update=self._note_change)
        self._drawn, self._was_watched = float("-inf"), False
        self._has_changed = self._is_drawing = False
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_PLACE_PERIOD, self._show_places, clock=steady)
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

    def _hear(self, text: str) -> None:
        self._board.hear(text, time.monotonic())

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
