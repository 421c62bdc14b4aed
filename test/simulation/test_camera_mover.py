"""A simulated robot whose base stops beside its goal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.cli.command_options import with_settings
from infomap_ros.exploration.loop import camera_error
from infomap_ros.exploration.robot import Choice, Interrupted, Motion, RobotState
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, ExplorationRun

SETTINGS = (
    "world.name=mars",
    "world.seed=2",
    "world.size=4.5",
    "robot.pose_source=simulator",
    "robot.images_while_moving=false",
    "simulator.camera.width=320",
    "simulator.camera.height=240",
    "simulator.camera.supersampling=1",
    "planner.start_clearance=0.6",
)


class Watched:
    """An exploration whose choices, motions and log entries are kept."""

    def __init__(self, out: Path, views: int) -> None:
        settings = (*SETTINGS, f"task.max_views={views}")
        self.entries: list[Mapping[str, Any]] = []
        self.run = ExplorationRun(
            with_settings(ExplorationOptions(), settings), out, self.entries.append
        )
        self.robot = self.run.robot
        self.choices: list[Choice] = []
        planner = self.run._exploration._planner
        choose = planner.choose

        def kept(state: RobotState) -> Choice:
            self.choices.append(choose(state))
            return self.choices[-1]

        planner.choose = kept  # type: ignore[method-assign]

    def base(self) -> np.ndarray:
        return self.robot.state().T_map_base


def test_a_base_that_stops_beside_its_goal_still_brings_the_camera_to_its_view(
    tmp_path: Path,
) -> None:
    watched = Watched(tmp_path, views=5)
    drive, look, task = watched.robot.drive, watched.robot.look, watched.run._exploration.task
    has_driven, errors, offsets = [False], [], []

    def stop_beside(poses: np.ndarray, interrupted: Interrupted) -> Motion:
        """0.1 m before the end, turned by 0.15 rad."""
        goal = poses[-1].copy()
        moved = poses.copy()
        moved[-1, :2] -= 0.1 * np.array([np.cos(goal[2]), np.sin(goal[2])])
        moved[-1, 2] += 0.15
        motion = drive(moved, interrupted)
        has_driven[0] = True
        offsets.append(np.linalg.norm(watched.base()[:2, 3] - goal[:2]))
        return motion

    def measured(interrupted: Interrupted) -> str:
        if has_driven[0]:
            target = watched.choices[-1].target
            assert target is not None
            errors.append(camera_error(watched.robot.state().T_map_camera, target))
            has_driven[0] = False
        return look(interrupted)

    watched.robot.drive, watched.robot.look = stop_beside, measured  # type: ignore[method-assign]
    watched.run.run()
    contacts = watched.run.simulator.contact_events
    watched.run.close()

    assert len(errors) >= 1 and max(offsets) > 0.05
    misses = [e for e in watched.entries if e["kind"] == "message" and "off the view" in e["text"]]
    arrived = [
        away <= task.view_position_tolerance and turned <= task.view_angle_tolerance
        for away, turned in errors
    ]
    assert sum(arrived) >= 1
    assert sum(arrived) + len(misses) >= len(errors)  # where it has not arrived it says why
    assert contacts == ()
