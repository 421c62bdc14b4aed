"""The message on motion_results: what became of a motion, in the words of who carried it out.

The actions of control_msgs and nav2_msgs, and what their results say.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from infomap_ros.errors import MalformedMessageError, ResourceError

TOPIC = "motion_results"
BASE, ARM = "base_path", "arm_trajectory"
_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
_NANOSECONDS = 1_000_000_000


class Outcome(Enum):
    """How a motion ended; the value is the level of its diagnostic status."""

    SUCCEEDED = DiagnosticStatus.OK
    CANCELED = DiagnosticStatus.WARN
    FAILED = DiagnosticStatus.ERROR


@dataclass(frozen=True)
class MotionResult:
    """What became of one command.

    Attributes:
        topic: of the command, `BASE` or `ARM`.
        stamp: of the command's header [ns].
        label: frame_id of the command's header.
        outcome: how it ended.
        reason: in words; of a failure, those of the controller.
        parts: what each controller said, by its name.
    """

    topic: str
    stamp: int
    label: str
    outcome: Outcome
    reason: str
    parts: Mapping[str, str] = field(default_factory=dict)


class Order:
    """A motion that was commanded, until its result is reported, which is done once.

    Args:
        topic: of the command.
        stamp: of its header [ns].
        label: frame_id of its header.
        report: takes the result.
    """

    def __init__(
        self, topic: str, stamp: int, label: str, report: Callable[[MotionResult], None]
    ) -> None:
        self.topic, self._stamp, self._label, self._report = topic, stamp, label, report
        self.is_open = True

    def end(self, outcome: Outcome, reason: str, parts: Mapping[str, str] | None = None) -> None:
        """Report the result, unless that was done."""
        if self.is_open:
            self.is_open = False
            self._report(
                MotionResult(self.topic, self._stamp, self._label, outcome, reason, parts or {})
            )


def encode_motion_result(result: MotionResult) -> DiagnosticArray:
    """Build the message: the command's header, and a status of the motion as a whole."""
    status = DiagnosticStatus(
        level=result.outcome.value,
        name=result.topic,
        message=result.reason,
        values=[KeyValue(key=name, value=words) for name, words in result.parts.items()],
    )
    message = DiagnosticArray(status=[status])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(result.stamp, _NANOSECONDS)
    message.header.frame_id = result.label
    return message


def read_motion_result(message: DiagnosticArray) -> MotionResult:
    """Read what `encode_motion_result` wrote.

    Raises:
        MalformedMessageError: it has not one status, or an unknown level.
    """
    if len(message.status) != 1:
        raise MalformedMessageError(_TYPE, f"motion result: {len(message.status)} statuses")
    status, header = message.status[0], message.header
    try:
        outcome = Outcome(status.level)
    except ValueError as error:
        raise MalformedMessageError(_TYPE, f"motion result: level {status.level!r}") from error
    return MotionResult(
        status.name,
        header.stamp.sec * _NANOSECONDS + header.stamp.nanosec,
        header.frame_id,
        outcome,
        status.message,
        {pair.key: pair.value for pair in status.values},
    )


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
