"""A simulated exploration keeps out of regions, by the true poses that were driven."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infomap_ros.cli.command_options import with_settings
from infomap_ros.exploration.commanded_robot import CommandedRobot
from infomap_ros.exploration.robot import Interrupted, Motion
from infomap_ros.motion.base.path_following import PathFollowingConfig, drive_seconds
from infomap_ros.motion.route import ArmPath
from infomap_ros.simulation.body.base_motion import planar
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, ExplorationRun
from infomap_ros.simulation.simulator import Simulator

from .polygons import footprint_points, placed, winding_inside
from .test_driven_path import CONFIG, ROVER, world_with_box

SETTINGS = (
    "world.name=mars",
    "world.seed=2",
    "world.size=4.5",
    "task.max_views=5",
    "robot.pose_source=simulator",
    "robot.images_while_moving=false",
    "planner.choice.rating.cost=seconds",
)


def explored(out: Path, monkeypatch: pytest.MonkeyPatch, *settings: str) -> tuple[Any, Any, Any]:
    """True poses of the base in the map's frame during a run, its footprint, and the run."""
    run = ExplorationRun(with_settings(ExplorationOptions(), SETTINGS + settings), out)
    poses: list[np.ndarray] = []
    postures: list[dict[str, float]] = []  # while the base moves
    step = Simulator.step

    def watched(self: Simulator, duration: float) -> None:
        step(self, duration)
        pose = planar(np.linalg.inv(run.T_world_map) @ self.true_pose())
        if poses and math.dist(poses[-1][:2], pose[:2]) > 0.1 * duration:
            postures.append(dict(self.true_joints()))
        poses.append(pose)

    drive, move_arm = CommandedRobot.drive, CommandedRobot.move_arm

    def timed_drive(self: CommandedRobot, poses: np.ndarray, interrupted: Interrupted) -> Motion:
        begin, said = run.simulator.time, drive_seconds(poses, PathFollowingConfig())
        motion = drive(self, poses, interrupted)
        taken.append((said, run.simulator.time - begin))
        return motion

    def timed_arm(self: CommandedRobot, path: ArmPath, interrupted: Interrupted) -> Motion:
        begin = run.simulator.time
        motion = move_arm(self, path, interrupted)
        taken.append((path.duration, run.simulator.time - begin))
        return motion

    taken: list[tuple[float, float]] = []
    monkeypatch.setattr(CommandedRobot, "drive", timed_drive)
    monkeypatch.setattr(CommandedRobot, "move_arm", timed_arm)
    monkeypatch.setattr(Simulator, "step", watched)
    ending = run.run()
    run.close()
    said, took = np.array(taken).T  # motions that were told their time and the simulated time
    assert len(took) >= 6
    assert (np.abs(took - said) <= 0.15 * said + 0.5).all()
    assert took.sum() == pytest.approx(said.sum(), rel=0.1)
    assert ending is not None
    robot = run.robot.link.model
    folded = {joint.name: 0.0 for joint in robot.joints} | postures[len(postures) // 2]
    return np.array(poses), footprint_points(robot, folded), run


def text_of(corners: np.ndarray) -> str:
    return " ".join(f"{value:.3f}" for value in corners.ravel())


def entered(poses: np.ndarray, footprint: np.ndarray, corners: np.ndarray) -> np.ndarray:
    return np.array([winding_inside(placed(footprint, *p), corners).any() for p in poses])


def test_an_exploration_keeps_out_of_where_it_went_without_the_rule(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as first:
        free, footprint, run = explored(tmp_path / "free", first)
    reasons = (tmp_path / "free" / "exploration.jsonl").read_text().splitlines()
    assert any(" s away" in line for line in reasons), "views are rated in seconds"
    away = np.hypot(*(free[:, :2] - free[0, :2]).T)
    assert away.max() > 0.9, "it drives at all"
    middle = free[int(away.argmax()), :2]
    square = 0.3 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = np.round(middle + square, 3)
    assert entered(free, footprint, corners).any()
    assert not entered(free[:1], footprint, corners).any()
    low, high = free[0, :2] - 2.1, free[0, :2] + 2.1
    fence = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    kept, _, run = explored(
        tmp_path / "kept", monkeypatch,
        f"task.keep_out=stairs: {text_of(corners)}",
        f"task.geofence={text_of(fence).replace(' ', ',')}",
    )  # fmt: skip
    assert np.hypot(*(kept[:, :2] - kept[0, :2]).T).max() > 0.5
    assert not entered(kept, footprint, corners).any()
    for pose in kept[::3]:
        assert winding_inside(placed(footprint, *pose), fence).all()
    assert run.simulator.contact_events == ()


@pytest.mark.parametrize(
    "path",
    [
        [(0.0, 0.0, 0.0), (0.0, 0.0, -1.6), (0.0, -1.2, -1.6)],
        [(0.0, 0.0, 0.0), (-1.3, 0.0, 0.0)],
    ],
)
def test_a_drive_takes_as_long_in_the_simulator_as_it_is_said_to(path: list) -> None:
    """Within 15 %: what a rating in seconds counts is what the simulated time shows."""
    robot, poses = Simulator(world_with_box(), ROVER.read_text(encoding="utf-8"), CONFIG), []
    for a, b in pairwise(path):
        steps = max(1, math.ceil(math.dist(a, b) / 0.05))
        poses += [np.add(a, np.subtract(b, a) * n / steps) for n in range(steps)]
    poses.append(np.array(path[-1]))
    said, begin = drive_seconds(np.array(poses), PathFollowingConfig()), robot.time
    robot.follow_base_path(np.array(poses))
    while robot.is_moving:
        robot.step(0.05)
    assert robot.problem == ""
    assert robot.time - begin == pytest.approx(said, rel=0.15)
