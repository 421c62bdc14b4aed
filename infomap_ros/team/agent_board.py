"""What is known of the other robots of a team, and for how long it counts.

How far a robot had come is known for longer than where it stood: whoever repeats its old words
after it has fallen silent is refused. A robot whose clock went back learns it from its teammates
(`AgentBoard.past`) and goes on after what they know.

What a robot reports of itself, as a text: one JSON object, and the team's code behind it.

The object is the first line. Where the team has a key, a second line holds the message's code
(`team.authentication`); who has no key does not look at it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from typing import Any, NoReturn

import numpy as np

from infomap_ros.errors import CalibrationError, InvalidInputError, UpdateRefusedError
from infomap_ros.geometry import (
    PinholeCamera,
    quaternion_from_transform,
    transform_from_quaternion,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.team.agents import Agent
from infomap_ros.team.membership import NOT_AUTHENTIC, Membership, TeamKey
from infomap_ros.team.own_version import MOST_FOLLOWED
from infomap_ros.team.update import are_one_frame, is_newer, versions_ahead

SILENCE = 5.0
"""What a teammate was heading for no longer counts when it has not reported for so long [s]."""
_MEMORY = 60.0  # its body still counts for so long; then it is part of the scene [s]
_FORMAT = 1
_LONGEST = 65_536
_WHOLE = ("robot", "session", "version", "stamp", "since", "claim", "origin")
_REAL = ("max_range", "radius", "bottom", "top")
_TEXT = ("state", "description", "description_hash", "base_frame")
_LENS = ("width", "height", "fx", "fy", "cx", "cy")
_NAMES = frozenset(
    {"infomap_agent", "base", "camera", "goal", "covariance", "lens", "path", "joints", "claims"}
    | {*_WHOLE, *_REAL, *_TEXT}
)


def agent_to_text(agent: Agent, key: TeamKey | None = None) -> str:
    """What a robot reports of itself, signed if there is a key."""
    covariance = agent.covariance
    upper = None if covariance is None else covariance[np.triu_indices(6)].tolist()
    content: dict[str, Any] = {
        "infomap_agent": _FORMAT,
        **{name: int(getattr(agent, name)) for name in _WHOLE},
        **{name: float(getattr(agent, name)) for name in _REAL},
        **{name: getattr(agent, name) for name in _TEXT},
        "base": _numbers(agent.T_map_base),
        "camera": _numbers(agent.T_map_camera),
        "goal": None if agent.goal is None else _numbers(agent.goal),
        "covariance": upper,
        "lens": [getattr(agent.camera, name) for name in _LENS],
        "path": np.round(agent.path, 4).tolist(),
        "joints": {name: float(value) for name, value in agent.joints.items()},
        "claims": {str(robot): int(claim) for robot, claim in agent.claims.items()},
    }
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return text if key is None else f"{text}\n{key.code_of_text(text)}"


def agent_from_text(text: str, key: TeamKey | None = None) -> Agent:
    """Read what `agent_to_text` wrote.

    Args:
        text: as it was received.
        key: of the team; without one every message is taken for genuine.

    Raises:
        InvalidInputError: it is malformed, or says something impossible; names it.
        UpdateRefusedError: there is a key, and the message was not signed with it.
    """
    if len(text) > _LONGEST:
        raise InvalidInputError("agent", f"{len(text)} characters")
    content, _, code = text.partition("\n")
    if key is not None and not key.is_code_of_text(content, code):
        raise UpdateRefusedError("what was reported of a robot is not of this team", NOT_AUTHENTIC)
    try:
        fields = json.loads(content, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError("agent", f"is not JSON: {error}") from error
    if not isinstance(fields, dict) or fields.get("infomap_agent") != _FORMAT:
        raise InvalidInputError("agent", f"is not an object of format {_FORMAT}")
    if missing := _NAMES - fields.keys():
        raise InvalidInputError("agent", f"lacks {', '.join(sorted(missing))}")
    try:
        return _read(fields)
    except (TypeError, ValueError, KeyError, OverflowError, CalibrationError) as error:
        raise InvalidInputError("agent", str(error)) from error


def _read(fields: Mapping[str, Any]) -> Agent:
    plain: dict[str, Any] = {
        **{name: _whole(fields[name], name) for name in _WHOLE},
        **{name: _real(fields[name], name) for name in _REAL},
        **{name: _word(fields[name], name) for name in _TEXT},
    }
    known = _object(fields["claims"], "claims")
    return Agent(
        **plain,
        T_map_base=_pose(fields["base"], "base"),
        T_map_camera=_pose(fields["camera"], "camera"),
        goal=None if fields["goal"] is None else _pose(fields["goal"], "goal"),
        covariance=None if fields["covariance"] is None else _covariance(fields["covariance"]),
        camera=_camera(fields["lens"]),
        path=np.array([_row(row, 3, "path") for row in _list(fields["path"], "path")]).reshape(
            -1, 3
        ),
        joints={name: _real(q, name) for name, q in _object(fields["joints"], "joints").items()},
        claims={int(robot): _whole(claim, "claims") for robot, claim in known.items()},
    )


def _numbers(transform: FloatArray) -> list[float]:
    """x, y, z [m] and the quaternion x, y, z, w."""
    return [*transform[:3, 3].tolist(), *quaternion_from_transform(transform).tolist()]


def _pose(value: object, name: str) -> FloatArray:
    row = _row(value, 7, name)
    return transform_from_quaternion(row[3:], row[:3])


def _covariance(value: object) -> FloatArray:
    matrix = np.zeros((6, 6))
    matrix[np.triu_indices(6)] = _row(value, 21, "covariance")
    return np.asarray(matrix + np.triu(matrix, 1).T)


def _camera(value: object) -> PinholeCamera:
    width, height, fx, fy, cx, cy = _row(value, 6, "lens").tolist()
    return PinholeCamera(int(width), int(height), fx, fy, cx, cy)


def _row(value: object, count: int, name: str) -> FloatArray:
    row = [_real(number, name) for number in _list(value, name)]
    if len(row) != count:
        raise InvalidInputError(f"agent {name}", f"{len(row)} numbers, expected {count}")
    return np.array(row)


def _list(value: object, name: str) -> list[Any]:
    if not isinstance(value, list):
        raise InvalidInputError(f"agent {name}", "is not a list")
    return value


def _object(value: object, name: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InvalidInputError(f"agent {name}", "is not an object")
    return value


def _whole(value: object, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise InvalidInputError(f"agent {name}", f"{value!r} is not a whole number")
    return value


def _real(value: object, name: str) -> float:
    number = float(value) if isinstance(value, (int, float)) else np.nan
    if isinstance(value, bool) or not np.isfinite(number):
        raise InvalidInputError(f"agent {name}", f"{value!r} is not a finite number")
    return number


def _word(value: object, name: str) -> str:
    if not isinstance(value, str):
        raise InvalidInputError(f"agent {name}", "is not a text")
    return value


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


class AgentBoard:
    """What is known of the other robots. Texts are handed in, and so is the time.

    Args:
        robot: id of this robot.
        session: number that it drew when it started; None where it only listens.
        team: ids of the robots that count; all if empty.
        key: of the team; without one every message is taken for genuine.

    Attributes:
        origin: names the frame of this robot's map: those in others are known, but not present,
            as nobody can say where they are. 0 where that is of no matter.
    """

    origin = 0

    def __init__(
        self,
        robot: int,
        session: int | None,
        team: Collection[int] = (),
        key: TeamKey | None = None,
    ) -> None:
        self._key = key
        self._robot, self._listens = robot, session is None
        self._membership = Membership(robot, session, team, SILENCE)
        self._agents: dict[int, Agent] = {}
        self._received: dict[int, float] = {}
        self._newest: dict[int, int] = {}
        self._past: dict[int, float] = {}
        self._now = -math.inf

    def receive(self, text: str, now: float, own_version: int = 0) -> Agent | None:
        """Learn what a robot reports of itself.

        Args:
            text: as `team.agent_text.agent_to_text` writes it.
            now: time of any steady clock [s].
            own_version: the newest version of this robot.

        Returns:
            What it reports, if that is new: neither this robot's own words nor older than what is
            known.

        Raises:
            InvalidInputError: the text is malformed, or says something impossible.
            UpdateRefusedError: it is not of this team, two robots have one id, or its version is
                impossible after those that were received.
        """
        agent = agent_from_text(text, self._key)
        self._now = now
        self._forget(now)
        if agent.robot == self._robot and self._listens:
            return None
        is_known = self._membership.knows(agent.robot, agent.session)
        self._membership.check_update(agent, now, own_version)
        if agent.robot == self._robot:
            return None
        if self._is_past(agent, is_known):
            self._past[agent.robot] = now
            return None
        self._agents[agent.robot] = agent
        self._received[agent.robot] = now
        self._past.pop(agent.robot, None)
        self._newest[agent.robot] = agent.version
        return agent

    def _is_past(self, agent: Agent, is_known: bool) -> bool:
        """Whether a robot has reported something newer before.

        Who was silent for long and starts again with a clock that was never set cannot catch up,
        and reports.
        """
        newest = self._newest.get(agent.robot)
        if newest is None or is_newer(agent.version, newest):
            return False
        starts_again = agent.robot not in self._agents and not is_known
        return not (starts_again and versions_ahead(newest, agent.version) > MOST_FOLLOWED)

    def present(self, now: float) -> tuple[Agent, ...]:
        """The others that have reported lately, by id; their goals count."""
        return tuple(
            agent
            for robot, agent in sorted(self._agents.items())
            if now - self._received[robot] <= SILENCE and self.shares_frame(agent)
        )

    def remembered(self, now: float) -> tuple[Agent, ...]:
        """All whose bodies count, by id: those that are present and those silent for long."""
        self._forget(now)
        known = (agent for _, agent in sorted(self._agents.items()))
        return tuple(agent for agent in known if self.shares_frame(agent))

    def shares_frame(self, agent: Agent) -> bool:
        """Whether it can be said where a robot is in the map of this one."""
        return are_one_frame(agent.origin, self.origin)

    def claims(self, now: float) -> dict[int, int]:
        """Claims of the others that are known, by their ids."""
        return {agent.robot: agent.claim for agent in self.present(now)}

    def past(self) -> dict[int, int]:
        """Newest versions that are known of robots that spoke with older ones lately, by id."""
        return {r: self._newest[r] for r, at in self._past.items() if self._now - at <= SILENCE}

    def _forget(self, now: float) -> None:
        silent = [r for r, at in self._received.items() if now - at > _MEMORY]
        for robot in silent:
            del self._received[robot], self._agents[robot]
