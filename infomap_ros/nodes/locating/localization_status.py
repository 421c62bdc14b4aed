"""The message on localization_status, written by fiducial_localization and read by explorer."""

from __future__ import annotations

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from infomap_ros.errors import MalformedMessageError
from infomap_ros.localization.localized_camera import LocalizedCamera

LOCALIZATION_STATUS = "localization_status"
LOOKING, SEEN = "looking", "seen"
_NAME = "localization"
_TYPE = "diagnostic_msgs/msg/DiagnosticStatus"
_LEVELS = {
    "tracking": DiagnosticStatus.OK,
    "coasting": DiagnosticStatus.WARN,
    "lost": DiagnosticStatus.ERROR,
    "searching": DiagnosticStatus.WARN,
}


@dataclass(frozen=True)
class LocalizationState:
    """What became of one view.

    Attributes:
        stamp: of the view [ns].
        state: ``tracking``, ``coasting``, ``lost`` or ``searching``, as of `LocalizedCamera`.
        reason: why it is not tracking; may be empty.
        team: ``looking`` where a teammate with tags is still to be found, ``seen`` where one is in
            view; else empty.
    """

    stamp: int
    state: str
    reason: str
    team: str = ""


def status_message(result: LocalizedCamera, team: str = "") -> DiagnosticStatus:
    """What became of a view, as a message."""
    values = {"stamp": result.stamp, "state": result.state, "reason": result.reason, "team": team}
    return DiagnosticStatus(
        level=_LEVELS[result.state],
        name=_NAME,
        message=f"{result.state}: {result.reason}" if result.reason else result.state,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )


def read_status(message: DiagnosticStatus) -> LocalizationState:
    """Read what `status_message` wrote.

    Raises:
        MalformedMessageError: a value is missing or impossible.
    """
    values = {pair.key: pair.value for pair in message.values}
    try:
        known = int(values["stamp"]), values["state"], values["reason"]
        status = LocalizationState(*known, values.get("team", ""))
    except (KeyError, ValueError) as error:
        raise MalformedMessageError(_TYPE, f"localization status: {error!r}") from error
    if status.state not in _LEVELS:
        raise MalformedMessageError(_TYPE, f"localization status: state '{status.state}'")
    return status
