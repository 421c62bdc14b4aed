"""A small world explored without any true pose: what the robot believes, against the truth."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from infomap_ros.cli.settings import with_settings
from infomap_ros.errors import InvalidInputError, PoseUnavailableError
from infomap_ros.exploration.loop import EndReason
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.localization.localisation import Localisation, State
from infomap_ros.mapping import VoxelMap
from infomap_ros.simulation.exploring.exploration_run import (
    ExplorationOptions,
    ExplorationRun,
    map_frame,
    task_in,
)
from infomap_ros.simulation.exploring.exploring_robot import ExploringRobotConfig
from infomap_ros.simulation.exploring.self_localisation import SelfLocalisation
from infomap_ros.simulation.exploring.visible_surface import map_errors
from infomap_ros.simulation.worlds.scenes import make_world

SETTINGS = (
    "world.name=mars",
    "world.seed=2",
    "world.size=4.5",
    "task.max_views=3",
    "simulator.camera.width=320",
    "simulator.camera.height=240",
    "simulator.camera.supersampling=1",
)


@pytest.fixture(scope="module")
def explored(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ExplorationRun]:
    """Three views of a crater of 4.5 m, with a small camera."""
    out = tmp_path_factory.mktemp("explored")
    run = ExplorationRun(with_settings(ExplorationOptions(), SETTINGS), out)
    ending = run.run()
    assert ending.reason is EndReason.BUDGET_SPENT, ending.detail
    run.write_results(ending)
    yield run
    run.close()


def test_the_map_has_its_origin_at_the_target(explored: ExplorationRun) -> None:
    target = explored.simulator.world.T_world_target
    assert target is not None
    np.testing.assert_allclose(explored.T_world_map, target, atol=1e-12)


def test_poses_are_as_wrong_as_they_say(explored: ExplorationRun) -> None:
    poses = explored.audit.poses
    assert len(poses) == 6  # two scans per view
    assert max(float(np.linalg.norm(pose.error[:3])) for pose in poses) < 0.06
    assert np.mean([pose.nees for pose in poses]) < 3 * 6


def test_the_map_lies_where_the_target_says(explored: ExplorationRun) -> None:
    errors = map_errors(explored.map, explored.simulator.world, explored.T_world_map)
    assert errors.share_within(3.0) > 0.9
    assert np.median(errors.distances) < 0.02


def test_scans_are_kept_with_the_covariances_of_their_poses(
    explored: ExplorationRun,
) -> None:
    told = {pose.stamp: pose.pose.covariance for pose in explored.audit.poses}
    kept = {scan.stamp: scan.uncertainty.covariance for scan in explored._robot._map.store}
    assert kept.keys() == told.keys()
    for stamp, covariance in told.items():
        np.testing.assert_allclose(kept[stamp], covariance, rtol=1e-9)


def test_views_were_chosen_by_predicted_localization_errors(explored: ExplorationRun) -> None:
    predictions = explored.audit.predictions
    assert len(predictions) == 2
    for prediction in predictions:
        assert 0.2 < prediction.predicted / prediction.claimed < 5.0


def test_without_the_target_in_view_it_does_not_start(explored: ExplorationRun) -> None:
    poses = explored._robot.poses
    assert isinstance(poses, SelfLocalisation)
    blind = SelfLocalisation(explored.simulator, poses._robot, explored.options.robot.stereo)
    with pytest.raises(PoseUnavailableError, match="no pair was taken"):
        blind.pose()


@pytest.mark.parametrize(
    ("told", "pairs", "is_told"),
    [
        ([("tracking", False)], 1, True),
        ([("coasting", False), ("coasting", False), ("tracking", False)], 3, True),
        ([("coasting", False), ("coasting", True)], 2, False),
        ([("coasting", False)] * 4, 4, False),
        ([("lost", False)], 1, False),
    ],
)
def test_a_view_without_known_fiducials_is_taken_again(
    explored: ExplorationRun,
    monkeypatch: pytest.MonkeyPatch,
    told: list[tuple[State, bool]],
    pairs: int,
    is_told: bool,
) -> None:
    poses = explored._robot.poses
    assert isinstance(poses, SelfLocalisation)
    see, taken = poses.see, list[StereoView]()

    def seen(voxel_map: VoxelMap | None = None) -> StereoView:
        state, contradicted = told[len(taken)]
        taken.append(see(voxel_map))
        poses.last = Localisation(0, state, None, None, contradicted=contradicted)
        return taken[-1]

    monkeypatch.setattr(poses, "see", seen)
    explored.simulator.step(0.1)
    if is_told:
        assert poses.take_scan(explored.map).stamp == taken[-1].stamp
    else:
        with pytest.raises(PoseUnavailableError):
            poses.take_scan(explored.map)
    assert len(taken) == pairs


def test_what_was_kept_tells_the_pose_without_the_target(
    explored: ExplorationRun, tmp_path: Path
) -> None:
    poses = explored._robot.poses
    assert isinstance(poses, SelfLocalisation)
    poses.save(tmp_path / "localisation.infomap")
    again = SelfLocalisation(explored.simulator, poses._robot, explored.options.robot.stereo)
    again.resume(tmp_path / "localisation.infomap")
    kept, resumed = poses.localizer.fiducials(), again.localizer.fiducials()
    np.testing.assert_array_equal(resumed.ids, kept.ids)
    np.testing.assert_allclose(resumed.positions, kept.positions, atol=1e-9)
    again.initialise()

    assert again.last is not None
    assert not again.last.target_seen
    audited = explored.audit.audit(explored.simulator.stamp, again.pose())
    assert np.linalg.norm(audited.error[:3]) < 0.06


def test_a_world_without_target_is_refused() -> None:
    world = make_world("mars", 1, size=4.5, target_distance=0.0)
    with pytest.raises(InvalidInputError, match="target"):
        map_frame(world, ExploringRobotConfig())


def test_the_region_of_the_task_is_that_of_the_world_seen_from_the_target() -> None:
    world = make_world("mars", 1, size=4.5)
    assert world.T_world_target is not None
    task = task_in(world, TaskConfig(), world.T_world_target)
    x, y, z = world.T_world_target[:3, 3]
    low, high = world.region
    np.testing.assert_allclose(task.region_low, (x - high[0], y - high[1], low[2] - z))
    np.testing.assert_allclose(task.region_high, (x - low[0], y - low[1], high[2] - z))
