"""What robots tell of themselves survives the way into a message of either family and back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.messages import RosbagsMessageTypes
from infomap_ros.messages.agents import AGENTS, BODY, GOAL, decode_agent_texts, encode_agent
from infomap_ros.team.agent_board import agent_from_text, agent_to_text
from infomap_ros.team.agents import Agent

CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
TYPES = RosbagsMessageTypes()


def agent(**fields: Any) -> Agent:
    base, goal = (make_transform(np.eye(3), (x, 2.0, 0.5)) for x in (1.0, 3.0))
    given: dict[str, Any] = {"radius": 0.4, "bottom": -0.1, "top": 0.9, "goal": goal}
    stamp = 2_000_000_003
    return Agent(7, 1, 5, stamp, stamp, base, base, None, CAMERA, 4.0, **(given | fields))


def encoded(told: Agent) -> Any:
    return encode_agent(TYPES, "map", told, agent_to_text(told), 5.0)


def test_a_message_tells_what_the_text_tells() -> None:
    typestore = RosbagsMessageTypes()._store
    data = typestore.serialize_cdr(encoded(agent()), AGENTS)
    message = typestore.deserialize_cdr(data, AGENTS)
    ((frame, text),) = decode_agent_texts(message)
    assert frame == "map"
    assert agent_from_text(text).goal is not None
    assert len(data) < 2500


def test_the_eye_sees_body_and_goal_where_they_are() -> None:
    body, goal, state = encoded(agent()).markers
    assert (body.ns, body.id, goal.id) == ("robot7", BODY, GOAL)
    middle = body.pose.position
    assert (middle.x, middle.y, middle.z) == (1.0, 2.0, pytest.approx(0.9))
    assert (body.scale.x, body.scale.z) == (0.8, pytest.approx(1.0))
    assert (body.header.stamp.sec, body.header.stamp.nanosec) == (2, 3)
    assert body.lifetime.sec == 5
    points = np.array([(p.x, p.y, p.z) for p in goal.points])
    assert points.shape == (16, 3)
    in_camera = points - (3.0, 2.0, 0.5)
    far = in_camera[in_camera[:, 2] > 0.1]
    assert np.allclose(np.abs(far[:, 0] / far[:, 2]), 32.0 / 50.0)
    assert np.allclose(np.abs(far[:, 1] / far[:, 2]), 24.0 / 50.0)
    assert state.text == "7: idle"


def test_without_a_goal_its_lines_are_deleted() -> None:
    _, goal, _ = encoded(agent(goal=None)).markers
    assert (goal.action, len(goal.points)) == (2, 0)


def test_other_markers_are_passed_over_and_broken_ones_refused() -> None:
    message = encoded(agent())
    assert decode_agent_texts(SimpleNamespace(markers=list(message.markers[1:]))) == []
    for broken in ({}, {"id": "a"}, {"id": 0, "action": 0, "header": 3}):
        with pytest.raises(MalformedMessageError, match="MarkerArray"):
            decode_agent_texts(SimpleNamespace(markers=[SimpleNamespace(**broken)]))
