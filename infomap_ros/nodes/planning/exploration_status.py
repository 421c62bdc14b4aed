"""The message on exploration_status, written by explorer and read by next_best_view."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from infomap_ros.errors import InvalidInputError, MalformedMessageError
from infomap_ros.exploration.loop import Exploration
from infomap_ros.exploration.mission import HOME, LAST_LOOK, look_poses, read_place
from infomap_ros.exploration.robot import FailedView, KnownPlace
from infomap_ros.geometry import check_transform
from infomap_ros.geometry.transforms import FloatArray

_NAME = "exploration"
_TYPE = "diagnostic_msgs/msg/DiagnosticStatus"


@dataclass(frozen=True, eq=False)
class ExplorationStatus:
    """What next_best_view learns from exploration_status.

    Attributes:
        views: taken so far.
        home: where the mission began.
        last_look: where the last look succeeded.
        home_pose: ``T_map_base`` of the beginning, shape (4, 4); None where not yet known.
        failed_view: the last view that brought nothing; None before.
        failures: number of views that brought nothing so far.
        looks: ``T_map_camera`` of the views taken so far, shape (V, 4, 4).
    """

    views: int = 0
    home: KnownPlace = HOME
    last_look: KnownPlace = LAST_LOOK
    home_pose: FloatArray | None = None
    failed_view: FailedView | None = None
    failures: int = 0
    looks: FloatArray = field(default_factory=lambda: np.empty((0, 4, 4)))


def status_message(
    exploration: Exploration, failed_views: Sequence[FailedView]
) -> DiagnosticStatus:
    """State, figures and last reason of an exploration, and the views that brought nothing."""
    progress, mission = exploration.progress, exploration.mission
    figures: dict[str, object] = {
        "state": exploration.state,
        "last reason": exploration.last_reason,
        "views": mission.views,
        "distance [m]": round(mission.distance, 2),
        **_place_texts(mission.home),
        **_place_texts(mission.last_look),
        "home pose": json.dumps(mission.home_pose),
        "looks": json.dumps(mission.looks),
    }
    if progress is not None:
        figures |= {
            "known fraction": round(progress.known_fraction, 4),
            "remaining entropy [bits]": round(progress.entropy_bits, 1),
            "precise fraction": round(progress.precise_fraction, 4),
            "mean sigma [m]": round(progress.mean_sigma, 5),
            "surface voxels": progress.surface_voxels,
        }
    figures["failures"] = len(failed_views)
    if failed_views:
        last = failed_views[-1]
        figures |= {
            "failed view": json.dumps(last.pose.tolist()),
            "failed view reached": json.dumps(last.reached),
            "failure": last.reason,
        }
    failed = exploration.state == "ended: failed"
    return DiagnosticStatus(
        level=DiagnosticStatus.ERROR if failed else DiagnosticStatus.OK,
        name=_NAME,
        message=exploration.state,
        values=[KeyValue(key=key, value=str(value)) for key, value in figures.items()],
    )


def read_status(message: DiagnosticStatus) -> ExplorationStatus:
    """Read what `status_message` wrote.

    Raises:
        MalformedMessageError: a value is missing or impossible.
    """
    values = {pair.key: pair.value for pair in message.values}
    try:
        home, last_look = _place(values, HOME), _place(values, LAST_LOOK)
        pose = _pose(values.get("home pose", "[]"))
        view = _failed_view(values)
        views, failures = int(values["views"]), int(values["failures"])
        looks = look_poses(json.loads(values.get("looks", "[]")))
        return ExplorationStatus(views, home, last_look, pose, view, failures, looks)
    except (KeyError, ValueError, TypeError, AttributeError, InvalidInputError) as error:
        raise MalformedMessageError(_TYPE, f"exploration status: {error!r}") from error


def _place_texts(place: KnownPlace) -> dict[str, object]:
    return {
        f"{place.name} base": json.dumps(place.base),
        f"{place.name} joints": json.dumps(dict(place.joints)),
    }


def _place(values: Mapping[str, str], kind: KnownPlace) -> KnownPlace:
    base, joints = values[f"{kind.name} base"], values[f"{kind.name} joints"]
    return read_place(kind, json.loads(base), json.loads(joints))


def _failed_view(values: Mapping[str, str]) -> FailedView | None:
    """What `status_message` says of the last view that brought nothing."""
    pose = _pose(values.get("failed view", "[]"))
    reached = json.loads(values.get("failed view reached", "false"))
    if not isinstance(reached, bool):
        raise ValueError(f"failed view reached: {reached!r} is neither true nor false")
    return None if pose is None else FailedView(pose, values.get("failure", ""), reached)


def _pose(text: str) -> FloatArray | None:
    """A pose, shape (4, 4), from its JSON; None from that of an empty list."""
    rows = json.loads(text)
    return None if rows == [] else check_transform(np.array(rows, dtype=np.float64))
