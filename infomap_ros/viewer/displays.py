"""Shows on a page, in the process that works, how a recording or a simulated world is mapped."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from infomap_ros.exploration.records.recorded_run import parse_record
from infomap_ros.exploration.records.run_log import (
    Candidate,
    Decision,
    End,
    Message,
    Motion,
    Progress,
    Start,
    rating_text,
)
from infomap_ros.exploration.reports.report_page.scene import BASE_ACTIONS, COLOR_MAPS
from infomap_ros.exploration.robot import RobotState
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.viewer.live_page import LivePage
from infomap_ros.viewer.run_panel import map_figures
from infomap_ros.viewer.shapes import REJECTED, colored
from infomap_ros.viewer.views_layer import ConsideredView


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
        if known and known != self._drawn:  # also unwatched: who opens the page later sees it
            self._page.map.show(self._map)
            self._drawn = known


class LogDisplay:
    """Feeds a page from a run log.

    Args:
        page: to be fed.

    Attributes:
        camera: of the run; None before its log has told it.
    """

    def __init__(self, page: LivePage) -> None:
        self._page = page
        self.camera: PinholeCamera | None = None

    def show(self, entry: Mapping[str, Any]) -> None:
        """Show an entry.

        Raises:
            RunLogError: it lacks a field or holds what does not belong there.
        """
        page, record = self._page, parse_record(entry)
        if isinstance(record, Start):
            self.camera = record.camera
        elif isinstance(record, Progress):
            page.panel.show_state(record.state or "running", figures_of(record))
            page.panel.add_point(record.known_fraction, record.precise_fraction)
        elif isinstance(record, Decision):
            page.views.show(considered_views(record.candidates))
            page.views.show_chosen(record.pose, self.camera, record.reason)
            page.panel.say(record.reason)
        elif isinstance(record, Motion):
            if record.action in BASE_ACTIONS:
                page.views.show_path(record.path)
            if record.outcome:
                page.panel.say(f"{record.action}: {record.outcome}", "warning")
        elif isinstance(record, Message):
            page.panel.say(record.text, record.level)
        elif isinstance(record, End):
            page.panel.say(f"ended: {record.reason}, {record.detail}".rstrip(", "))


def figures_of(progress: Progress) -> dict[str, str]:
    """How far a run is, as a page tells it."""
    figures = {"views": str(progress.views), "distance": f"{progress.distance:.1f} m"}
    figures |= map_figures(progress.known_fraction, progress.precise_fraction, progress.mean_sigma)
    figures["surface"] = f"{progress.surface_voxels:,} voxels"
    figures["remaining entropy"] = f"{progress.entropy_bits:,.0f} bits"
    return figures


def considered_views(candidates: tuple[Candidate, ...]) -> list[ConsideredView]:
    """Candidates of a decision as a page shows them, colored by their rating."""
    ratings = np.array([candidate.rating for candidate in candidates], dtype=np.float64)
    known = ratings[np.isfinite(ratings)]
    ends = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    colors = colored(np.nan_to_num(ratings, nan=ends[0]), *ends, COLOR_MAPS["rating"])
    return [
        ConsideredView(
            candidate.position,
            candidate.direction,
            REJECTED if candidate.rejection else (int(color[0]), int(color[1]), int(color[2])),
            candidate.rejection or rating_text(candidate.rating, candidate.terms),
            bool(candidate.rejection),
        )
        for candidate, color in zip(candidates, colors, strict=True)
    ]


_MAP_PERIOD = 1.0  # between two pictures of the map at least [s]
_SHARE = 0.2  # of the time may be spent on them


class ScanDisplay:
    """Feeds a page frame by frame.

    Args:
        page: to be fed.
        what: is counted, in the plural.
    """

    def __init__(self, page: LivePage, what: str) -> None:
        self._page, self._what = page, what
        self._next = 0.0

    def show(
        self,
        done: int,
        total: int,
        T_map_camera: FloatArray | None,
        voxel_map: VoxelMap | None = None,
    ) -> None:
        """Show how far it is.

        Args:
            done: so many.
            total: of so many.
            T_map_camera: newest pose of the camera, shape (4, 4); None where it is not known.
            voxel_map: what has been mapped; drawn now and then, where somebody looks.
        """
        page = self._page
        page.panel.show_state(f"{done} of {total} {self._what}", _figures(voxel_map))
        if T_map_camera is not None:
            page.robot.show_camera(T_map_camera, None)
        start = time.monotonic()
        if voxel_map is not None and page.is_watched and start >= self._next:
            page.map.show(voxel_map)
            end = time.monotonic()
            self._next = end + max(_MAP_PERIOD, (end - start) / _SHARE)

    def finish(self, voxel_map: VoxelMap | None, summary: str) -> None:
        """Show the map as it has become, whether or not anybody looks yet."""
        if voxel_map is not None:
            self._page.map.show(voxel_map)
        self._page.panel.show_state("done", _figures(voxel_map))
        self._page.panel.say(summary)


def _figures(voxel_map: VoxelMap | None) -> dict[str, str]:
    if voxel_map is None:
        return {}
    return {
        "surface": f"{voxel_map.surface_voxels:,} voxels",
        "known": f"{voxel_map.known_voxels:,} voxels",
    }
