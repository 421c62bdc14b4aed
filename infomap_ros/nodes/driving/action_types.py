"""The actions of control_msgs and nav2_msgs, and what their results say."""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

from infomap_ros.errors import ResourceError

FOLLOW_JOINT_TRAJECTORY = "control_msgs/action/FollowJointTrajectory"
FOLLOW_PATH = "nav2_msgs/action/FollowPath"
NAVIGATE_THROUGH_POSES = "nav2_msgs/action/NavigateThroughPoses"


@cache
def action_class(type_name: str) -> Any:
    """The rclpy class of an action.

    Args:
        type_name: for example ``nav2_msgs/action/FollowPath``.

    Raises:
        ResourceError: its package is not installed; says how to get it.
    """
    package, _, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.action"), name)
    except ModuleNotFoundError as error:
        debian = f"ros-jazzy-{package.replace('_', '-')}"
        raise ResourceError(
            f"{type_name} is not installed: sudo apt-get install {debian}, or without a ROS "
            "installation python -m infomap_ros.nodes.common.message_packages"
        ) from error


def explain_trajectory(result: Any) -> str:
    """Error of a result of FollowJointTrajectory by its name, and the text; empty for none."""
    return _explain(result, result.error_string)


def explain_navigation(result: Any) -> str:
    """Error of a result of Nav2 by its name, and the text; empty for none."""
    return _explain(result, getattr(result, "error_msg", ""))


def _explain(result: Any, text: str) -> str:
    code = int(result.error_code)
    if code == 0:
        return ""
    kinds: list[Any] = [type(result)]
    if type(result).__module__.startswith("nav2_msgs"):
        kinds.append(action_class(FOLLOW_PATH).Result)  # what a navigator's controller said
    names = [name for kind in kinds for name in _constants(kind) if getattr(kind, name) == code]
    name = names[0] if names else "error"
    return f"{name} ({code}): {text}" if text else f"{name} ({code})"


def _constants(kind: Any) -> tuple[str, ...]:
    """Names of the constants of a message class, which rosidl makes properties of its class."""
    found = {name for base in (kind, type(kind)) for name in dir(base) if name.isupper()}
    return tuple(sorted(found))
