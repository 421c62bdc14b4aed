"""The message on motion_results: what became of a motion, in the words of who carried it out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from infomap_ros.errors import MalformedMessageError

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
