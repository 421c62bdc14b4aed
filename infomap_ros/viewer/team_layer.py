"""Teammates on the page: where they are, what they do, and where they are heading."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.team.agents import Agent
from infomap_ros.viewer.colors import TEAM
from infomap_ros.viewer.shapes import draw_way

_ABOVE = 0.2  # the body, of what it does in words [m]


class TeamLayer:
    """Draws the other robots of a team.

    Args:
        viser: the server.
    """

    def __init__(self, viser: Any) -> None:
        self._scene = viser.scene
        self._shown: set[int] = set()

    def show(self, mates: Sequence[Agent]) -> None:
        """Show those that are known now, and no others."""
        for robot in self._shown - {mate.robot for mate in mates}:
            self._scene.remove_by_name(f"/team/{robot}")
        self._shown = {mate.robot for mate in mates}
        for mate in mates:
            self._draw(mate)

    def _draw(self, mate: Agent) -> None:
        name, color = f"/team/{mate.robot}", TEAM[mate.robot % len(TEAM)]
        place: FloatArray = mate.T_map_base[:3, 3]
        middle = place + np.array([0.0, 0.0, 0.5 * (mate.bottom + mate.top)])
        height = max(mate.top - mate.bottom, 0.01)
        scene = self._scene
        scene.add_frame(name, show_axes=False)
        scene.add_cylinder(
            f"{name}/body", max(mate.radius, 0.01), height, color=color, opacity=0.4,
            position=tuple(middle),
        )  # fmt: skip
        above = place + np.array([0.0, 0.0, mate.top + _ABOVE])
        scene.add_label(f"{name}/state", f"{mate.robot}: {mate.state}", position=tuple(above))
        ground = np.column_stack([mate.way[:, :2], np.full(len(mate.way), place[2])])
        draw_way(scene, f"{name}/way", ground, color)
