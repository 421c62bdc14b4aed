"""The topic team/agents: this robot reports of itself, and learns of the others."""

from __future__ import annotations

import time

from visualization_msgs.msg import MarkerArray

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.exploration.team.teamwork import ANNOUNCE_PERIOD, Presence, Teamwork
from infomap_ros.exploration.view_planner import ViewPlannerConfig
from infomap_ros.geometry import CameraCalibration
from infomap_ros.messages.agents import encode_agent
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig
from infomap_ros.nodes.team.team_topics import AGENTS, TeamIdentityConfig, listen_to_agents
from infomap_ros.team.agent_board import SILENCE
from infomap_ros.team.agents import AgentsConfig
from infomap_ros.team.membership import draw_session
from infomap_ros.team.update import version_at

_TICK = 0.05  # between two looks whether there is something to send [s]
_HEARTBEAT = 1.0  # longest time without a message, also where nothing moves [s]


class TeamAgents:
    """Carries what robots report of themselves, for the node that chooses views.

    Args:
        node: that speaks; has the configurations of tracker, team and agents.
        tracker: knows where this robot is.

    Attributes:
        team: what is known of the others, and what this robot is heading for.
        doing: what this robot is doing, in words.
    """

    def __init__(self, node: MonitoredNode, tracker: RobotTracker) -> None:
        self._node, self._tracker = node, tracker
        self._frame = node.config(RobotTrackerConfig).map_frame
        self._range = node.config(ViewPlannerConfig).max_range
        who, agents = node.config(TeamIdentityConfig), node.config(AgentsConfig)
        identity = who.robot_id, draw_session(), version_at(time.time_ns())
        self.team = Teamwork(*identity, agents, who.team, who.read_key())
        self.doing = "idle"
        self._types, self._announced, self._stamp = RclpyMessageTypes(), float("-inf"), -1
        self._description = node.resolve_topic_name("robot_description")
        self._publisher = node.advertise(MarkerArray, AGENTS, qos.stream(depth=50))
        listen_to_agents(node, self._frame, lambda text: self.team.receive(text, time.monotonic()))
        node.repeat(_TICK, self._announce_if_due)

    def announce(self) -> None:
        """Report this robot now, if it knows where it is; called by any thread."""
        presence = self._presence()
        if presence is None:
            return
        self._announced, self._stamp = time.monotonic(), presence.stamp
        word = self.team.announcement(presence)
        self._publisher.publish(encode_agent(self._types, self._frame, *word, SILENCE))

    def _announce_if_due(self) -> None:
        """Send when so much time of the data has passed, and now and then in any case."""
        stamp = self._tracker.newest_stamp()
        period = round(ANNOUNCE_PERIOD * 1e9)
        is_due = stamp is not None and not self._stamp <= stamp < self._stamp + period
        if is_due or time.monotonic() - self._announced >= _HEARTBEAT:
            self._node.guard(AGENTS, self.announce)
        others = self.team.present(time.monotonic())
        self._node.health.note("teammates", ", ".join(str(each.robot) for each in others))

    def _presence(self) -> Presence | None:
        tracker = self._tracker
        try:
            stamp, state = tracker.stamped_state()
            calibration: CameraCalibration = tracker.calibrations[0]
            robot = tracker.robot
        except PoseUnavailableError:
            return None
        camera = calibration.rectified_camera()
        about = self.doing, self._description, tracker.description_hash
        origin = tracker.origin
        return Presence(stamp, state, robot, camera, self._range, *about, origin=origin)
