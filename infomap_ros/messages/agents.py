"""What a robot reports of itself, as a ``visualization_msgs/MarkerArray`` that RViz shows.

Three markers in the namespace ``robot<id>``: the cylinder about the body, the opening of the camera
at the goal view, and what the robot is doing. Only the cylinder's text is read, a JSON object
(`team.agent_text`); all else is for the eye.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry import PinholeCamera, make_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.fields import (
    MessageFields,
    MessageTypes,
    make_header,
    make_pose,
    make_vector,
)
from infomap_ros.team.agents import Agent

AGENTS = "visualization_msgs/msg/MarkerArray"
BODY, GOAL, STATE = 0, 1, 2
"""Ids of the markers."""

_LINE_LIST, _CYLINDER, _TEXT = 5, 3, 9
_ADD, _DELETE = 0, 2
_SHOWN_RANGE = 0.6  # of the goal's opening [m]
_LINE, _LETTERS = 0.02, 0.25  # [m]
# Of robots by their ids, one after the other: the first colors of Tableau.
_COLORS = ((0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17), (0.58, 0.4, 0.74))


def encode_agent(
    types: MessageTypes, frame_id: str, agent: Agent, text: str, lifetime: float
) -> Any:
    """Build the message about one robot.

    Args:
        types: who makes the message.
        frame_id: of the map.
        agent: the robot.
        text: the same as `team.agent_text.agent_to_text` writes it.
        lifetime: for how long it is shown [s].
    """
    height = max(agent.top - agent.bottom, 0.01)
    middle = make_transform(np.eye(3), (0.0, 0.0, 0.5 * (agent.top + agent.bottom)))
    above = make_transform(np.eye(3), agent.T_map_base[:3, 3] + (0.0, 0.0, agent.top + _LETTERS))
    size = np.array([2.0 * agent.radius, 2.0 * agent.radius, height])
    common = (types, frame_id, agent, lifetime)
    lines = np.empty((0, 3)) if agent.goal is None else _opening(agent.camera, agent.goal)
    return types.make(
        AGENTS,
        markers=[
            _marker(common, BODY, _CYLINDER, agent.T_map_base @ middle, size, text=text, alpha=0.3),
            _marker(common, GOAL, _LINE_LIST, np.eye(4), np.array([_LINE, 0, 0]), points=lines),
            _marker(
                common, STATE, _TEXT, above, np.array([0, 0, _LETTERS]),
                text=f"{agent.robot}: {agent.state}",
            ),
        ],
    )  # fmt: skip


def decode_agent_texts(message: object) -> list[tuple[str, str]]:
    """Frame and text of each robot that a ``visualization_msgs/MarkerArray`` has.

    Raises:
        MalformedMessageError: a marker lacks a field, or a field is of another type.
    """
    found = []
    for marker in MessageFields(message, AGENTS).children("markers"):
        if marker.integer("id", low=-(2**31)) != BODY or marker.integer("action") != _ADD:
            continue
        _, frame_id = marker.header()
        found.append((frame_id, marker.text("text")))
    return found


def _opening(camera: PinholeCamera, T_map_camera: FloatArray) -> FloatArray:
    """Ends of the eight edges of what a camera sees, shape (16, 3) [m, map]."""
    u = np.array([0.0, camera.width, camera.width, 0.0]) - 0.5
    v = np.array([0.0, 0.0, camera.height, camera.height]) - 0.5
    rays = np.column_stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(4)])
    corners = transform_points(T_map_camera, _SHOWN_RANGE * rays)
    tips = np.tile(T_map_camera[:3, 3], (4, 1))
    sides = np.stack([tips, corners], axis=1).reshape(-1, 3)
    edges = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1).reshape(-1, 3)
    return np.concatenate([sides, edges])


def _marker(
    common: tuple[MessageTypes, str, Agent, float],
    number: int,
    kind: int,
    pose: FloatArray,
    size: FloatArray,
    *,
    points: FloatArray | None = None,
    text: str = "",
    alpha: float = 1.0,
) -> Any:
    types, frame_id, agent, lifetime = common
    whole, rest = divmod(round(lifetime * 1e9), 1_000_000_000)
    none = np.zeros(0, np.uint8)
    is_shown = points is None or len(points) > 0
    r, g, b = _COLORS[agent.robot % len(_COLORS)]
    header = make_header(types, agent.stamp, frame_id)
    return types.make(
        "visualization_msgs/msg/Marker",
        header=header,
        ns=f"robot{agent.robot}",
        id=number,
        type=kind,
        action=_ADD if is_shown else _DELETE,
        pose=make_pose(types, pose),
        scale=make_vector(types, size),
        color=types.make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=alpha),
        lifetime=types.make("builtin_interfaces/msg/Duration", sec=whole, nanosec=rest),
        frame_locked=False,
        points=[_point(types, place) for place in (() if points is None else points)],
        colors=[],
        texture_resource="",
        texture=types.make("sensor_msgs/msg/CompressedImage", header=header, format="", data=none),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=types.make("visualization_msgs/msg/MeshFile", filename="", data=none),
        mesh_use_embedded_materials=False,
    )


def _point(types: MessageTypes, place: FloatArray) -> Any:
    x, y, z = (float(value) for value in place)
    return types.make("geometry_msgs/msg/Point", x=x, y=y, z=z)
