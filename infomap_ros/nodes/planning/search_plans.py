"""The order ~/plan_search of next_best_view: where to look for a target that is not in sight."""

from __future__ import annotations

from infomap_ros.exploration.records.choice_text import choice_to_text
from infomap_ros.exploration.target.target_search import TargetSearchPlanner
from infomap_ros.exploration.view_planner import ViewPlannerConfig
from infomap_ros.geometry import rig_from_calibrations
from infomap_ros.localization.target.search import TargetSearchConfig
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.robot_tracker import RobotTracker


class SearchPlans:
    """Plans look after look; used by the worker thread. A new robot begins the search anew.

    Args:
        node: has the configurations of planner and search.
        tracker: knows the robot, its cameras, and where odometry has it.
    """

    def __init__(self, node: MonitoredNode, tracker: RobotTracker) -> None:
        self._node, self._tracker = node, tracker
        self._planner: TargetSearchPlanner | None = None

    def plan(self) -> str:
        """The next look as text, pose and ways in the frame of odometry; nothing is published.

        What the camera sees from where it is counts as looked at in vain.

        Raises:
            InfomapError: something that is needed has not arrived.
        """
        robot, state = self._tracker.robot, self._tracker.state_in_odometry()
        if self._planner is None or self._planner.robot is not robot:
            camera = rig_from_calibrations(*self._tracker.calibrations).left
            configs = self._node.config(ViewPlannerConfig), self._node.config(TargetSearchConfig)
            self._planner = TargetSearchPlanner(robot, camera, *configs)
        choice = self._planner.choose(state)
        self._node.get_logger().info(choice.reason)
        return choice_to_text(choice)
