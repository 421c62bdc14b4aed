"""Node ``robot_driver``: carries out base_path and arm_trajectory on a robot's controllers.

Arm and base have each a back end, chosen by a parameter: actions of ros2_control and Nav2, topics
of trajectories, or velocities. A newer command takes the place of the one before; an empty
trajectory or a path of less than two poses stops, as do ~/stop, the end of this node, and the loss
of the explorer, which watches what is on the way; where this node is killed or hangs, a watchdog
stops the robot. What became of each command is on motion_results, with the controller's own words.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_srvs.srv import Trigger

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.motion.arm.controller_trajectories import read_controllers
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.driving.arm_driver import ArmDriver, action_of, topic_of
from infomap_ros.nodes.driving.base_driver import BaseDriver
from infomap_ros.nodes.driving.driver_config import RobotDriverConfig
from infomap_ros.nodes.driving.motion_result import (
    TOPIC,
    MotionResult,
    Outcome,
    encode_motion_result,
)
from infomap_ros.nodes.driving.watchdog import BEAT, Reach, Watchdog
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig

_LEAVING = 0.2  # [s] in which the last commands to stop leave this process


class RobotDriverNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (RobotDriverConfig, ""),
        (RobotTrackerConfig, ""),
        (AssumedPoseConfig, ""),
        (JointBufferConfig, "joints."),
    )

    SETTABLE = ("max_speed", "max_turn_rate", "acceleration", "turn_acceleration")

    def __init__(self, *, is_watched: bool = False, **node_arguments: Any) -> None:
        super().__init__("robot_driver", **node_arguments)
        config = self.config(RobotDriverConfig)
        if config.arm != "none" and not config.controllers:
            raise ConfigError("controllers", [], "the controllers of the arm, or arm: none")
        self._results = self.advertise(DiagnosticArray, TOPIC, qos.stream())
        self._drivers: list[ArmDriver | BaseDriver] = []
        if config.arm != "none":
            self._drivers.append(ArmDriver(self, self._report))
        if config.base != "none":
            self._drivers.append(BaseDriver(self, self._report))
        self._watchdog = Watchdog(self._reach(config)) if is_watched else None
        self.repeat(BEAT, self._beat)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.listen(
            DiagnosticStatus,
            "exploration_status",
            lambda _: None,  # that its publisher lives is all that counts
            qos.alive(qos.latched()),
            required=False,
            on_lost=partial(self._stop, "the explorer was killed or hangs"),
        )
        self.ends = partial(self._halt, "robot_driver was deactivated")
        self.get_logger().info(f"arm by {config.arm}, base by {config.base}")

    def _reach(self, config: RobotDriverConfig) -> Reach:
        """What must be stopped where this process is killed, or hangs."""
        actions, arms = [], {}
        controllers = {} if config.arm == "none" else read_controllers(config.controllers)
        for name, joints in controllers.items():
            if config.arm == "follow_joint_trajectory":
                actions.append(action_of(name))
            else:
                arms[self.resolve_topic_name(topic_of(name))] = tuple(joints)
        is_velocity = config.base.startswith("cmd_vel")
        if config.base != "none" and not is_velocity:
            actions.append(config.base)
        return Reach(
            tuple(map(self.resolve_service_name, actions)),
            arms,
            self.resolve_topic_name("joint_states"),
            (self.resolve_topic_name("cmd_vel"),) if is_velocity else (),
            config.base == "cmd_vel_stamped",
            self.get_namespace(),
        )

    def _report(self, result: MotionResult) -> None:
        """Publish what became of a motion, and say it."""
        self._results.publish(encode_motion_result(result))
        if result.outcome is Outcome.SUCCEEDED:
            self.health.produced()
            self.get_logger().info(f"{result.topic}: done")
        elif result.outcome is Outcome.CANCELED:
            self.get_logger().info(f"{result.topic}: canceled: {result.reason}")
        else:
            self.get_logger().error(f"{result.topic}: failed: {result.reason}")
        self.health.note(f"last of {result.topic}", result.reason or "done")

    def _beat(self) -> None:
        if self._watchdog is not None:
            self._watchdog.beat(any(driver.is_active for driver in self._drivers))

    def _stop(self, cause: str) -> bool:
        """Slow down and stand, whoever began it; returns whether this node did."""
        moving = any(driver.is_active for driver in self._drivers)
        for driver in self._drivers:
            driver.stop(cause)
        return moving

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        moving = self._stop("~/stop was called")
        words = (
            "stopping" if moving else "nothing that this node began moves; all was ordered to stop"
        )
        response.success, response.message = True, words
        return response

    def _halt(self, cause: str) -> bool:
        """Stop what moves; returns whether anything does."""
        moving = [driver for driver in self._drivers if driver.is_active]
        for driver in moving:
            driver.stop(cause)
            driver.halt()
        return bool(moving)

    def destroy_node(self) -> None:
        """Stop the robot, then the node."""
        if self._halt("robot_driver ends"):
            time.sleep(_LEAVING)
        if self._watchdog is not None:
            self._watchdog.part()
        super().destroy_node()


def main() -> int:
    """Run the node."""
    return run_node(partial(RobotDriverNode, is_watched=True))


if __name__ == "__main__":
    raise SystemExit(main())
