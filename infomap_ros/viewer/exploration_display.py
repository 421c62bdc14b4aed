"""Shows on a page how a simulated exploration goes on, in the process that carries it out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from infomap_ros.exploration.robot import RobotState
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion import RobotModel
from infomap_ros.viewer.live_page import LivePage
from infomap_ros.viewer.log_display import LogDisplay


class ShownRobot(Protocol):
    """What of a robot is drawn.

    Attributes:
        model: what it is.
    """

    model: RobotModel

    def known_state(self) -> RobotState | None:
        """Where it is; None where that is not known."""


class ExplorationDisplay:
    """Feeds a page from the log of the run, and draws map and robot whenever there is an entry.

    Args:
        page: to be fed.
        voxel_map: that grows.
        robot: that explores.
    """

    def __init__(self, page: LivePage, voxel_map: VoxelMap, robot: ShownRobot) -> None:
        self._page, self._map, self._robot = page, voxel_map, robot
        self._log, self._drawn = LogDisplay(page), -1

    def show(self, entry: Mapping[str, Any]) -> None:
        """Show an entry of the log, and what has changed since the last one."""
        self._log.show(entry)
        state = self._robot.known_state()
        if state is not None:
            self._page.robot.show(self._robot.model, state.T_map_base, state.joints)
            self._page.robot.show_camera(state.T_map_camera, self._log.camera)
        known = self._map.known_voxels
        is_last = entry["kind"] == "end"
        if known and known != self._drawn and (self._page.is_watched or is_last):
            self._page.map.show(self._map)
            self._drawn = known
