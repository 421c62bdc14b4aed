"""A simulated robot whose way is blocked while it drives, or whose base stops beside its goal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.cli.settings import with_settings
from infomap_ros.exploration.camera_mover import camera_error
from infomap_ros.exploration.loop import EndReason
from infomap_ros.exploration.robot import Choice, Interrupted, Motion, RobotState
from infomap_ros.mapping.voxels.voxel_states import VoxelStates, information_of, put_states
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, ExplorationRun

SETTINGS = (
    "world.name=mars",
    "world.seed=2",
    "world.size=4.5",
    "robot.pose_source=simulator",
    "planner.start_clearance=0.6",
)
BOX = 0.3  # edge [m]


class Watched:
    """An exploration whose choices, motions and log entries are kept."""

    def __init__(self, out: Path, views: int) -> None:
        settings = (*SETTINGS, f"task.max_views={views}")
        self.entries: list[Mapping[str, Any]] = []
        self.run = ExplorationRun(
            with_settings(ExplorationOptions(), settings), out, self.entries.append
        )
        self.robot, self.map = self.run._robot, self.run.map
        self.choices: list[Choice] = []
        planner = self.run._exploration._planner
        choose = planner.choose

        def kept(state: RobotState) -> Choice:
            self.choices.append(choose(state))
            return self.choices[-1]

        planner.choose = kept  # type: ignore[method-assign]

    def base(self) -> np.ndarray:
        return self.robot.state().T_map_base

    def put_box(self, place: np.ndarray) -> None:
        """Have the map show a box that stands on the ground at a place, shape (3,)."""
        size = self.map.config.voxel_size
        low = np.floor((place - [0.5 * BOX, 0.5 * BOX, 0.1]) / size).astype(np.int32)
        indices = np.indices([round(BOX / size)] * 3, np.int32).reshape(3, -1).T + low
        solid, quanta = np.ones(len(indices), bool), np.full(len(indices), 20, np.int32)
        covariances = np.tile(np.eye(3) * 1e-6, (len(indices), 1, 1))
        gaussians = information_of(indices, solid, (indices + 0.5) * size, covariances, size)
        put_states(self.map._storage, VoxelStates(indices, solid, quanta, gaussians))


def test_a_box_on_the_path_stops_the_drive_and_another_view_is_chosen(tmp_path: Path) -> None:
    watched = Watched(tmp_path, views=8)  # the base drives 0.8 m to the seventh
    drive, boxes, stopped = watched.robot.drive, [], []

    def box_ahead(poses: np.ndarray, interrupted: Interrupted) -> Motion:
        length = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum()
        begin = watched.base()[:2, 3].copy()

        def put_once() -> bool:
            gone = np.linalg.norm(watched.base()[:2, 3] - begin)
            if not boxes and length > 0.5 and gone > 0.1:
                end = watched.choices[-1].route.base_poses[-1][:3, 3]
                boxes.append(end)
                watched.put_box(end)
            return interrupted()

        motion = drive(poses, put_once)
        if boxes and not stopped:
            stopped.append((motion, watched.base()[:2, 3].copy()))
        return motion

    watched.robot.drive = box_ahead  # type: ignore[method-assign]
    ending = watched.run.run()
    contacts = watched.run.simulator.contact_events
    watched.run.close()

    assert ending.reason in (EndReason.BUDGET_SPENT, EndReason.NOTHING_LEFT), ending.detail
    ((motion, place),) = stopped
    assert motion.outcome == "broken off"
    assert np.linalg.norm(place - boxes[0][:2]) > 0.3
    texts = [entry["text"] for entry in watched.entries if entry["kind"] == "message"]
    assert any("drive: broken off: the base path is blocked at (" in text for text in texts)
    number = next(
        n for n, entry in enumerate(watched.entries)
        if entry["kind"] == "message" and "is blocked" in entry["text"]
    )  # fmt: skip
    later = [entry["kind"] for entry in watched.entries[number:]]
    assert "decision" in later and "motion" in later
    assert contacts == ()


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
