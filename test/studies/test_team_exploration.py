"""Two rovers explore one world together, and the software of one of them dies on the way."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from infomap_ros.cli.command_options import with_settings
from infomap_ros.errors import ExplorationError, PoseUnavailableError
from infomap_ros.simulation.exploring.simulated_robot import SimulatedRobot
from infomap_ros.simulation.turns import SwitchedOff, Turns
from infomap_ros.studies.team.team_exploration import TeamExploration
from infomap_ros.studies.team.team_network import Channel, Radio
from infomap_ros.studies.team.team_robot import TeamExplorationOptions

SMALL = (
    "world.size=4.5",
    "robot.pose_source=simulator",
    "robot.images_while_moving=false",
    "map.voxel_size=0.12",
    "simulator.camera.width=160",
    "simulator.camera.height=120",
    "simulator.camera.supersampling=1",
    "planner.threads=1",
    "planner.arm_views=50",
    "planner.choice.candidates.candidates=150",
    "planner.choice.selection.refined=10",
    "planner.reaching.postures=3000",
    "task.max_views=4",
    "team.coverage=0.4",
    "team.killed_at=0.15",
    "team.loss=0.2",
    "team.down=3.0",
    "sharing.recovery=2.0",
)


def test_two_rovers_with_losses_and_a_restart_end_with_one_map(tmp_path: Path) -> None:
    options = with_settings(TeamExplorationOptions(), SMALL)
    exploration = TeamExploration(options, tmp_path)

    figures = exploration.run()

    one, two = (robot for robot in exploration.robots if robot is not None)
    assert figures["kills"] == 1
    assert figures["same_hash"]
    assert one.member.replica.hash() == two.member.replica.hash()
    assert one.member.replica.robots == (0, 1)
    assert min(one.mission.views, two.mission.views) >= 1  # the account outlives the restart
    assert figures["views"] == one.mission.views + two.mission.views
    assert figures["true_coverage"] > 0.3
    assert figures["contacts"] == 0
    for robot, start in zip((one, two), exploration.world.starts, strict=True):
        declared = robot.equipment.options.planner.start_clearance
        assert declared == min(options.planner.start_clearance, start.clearance)


def test_rovers_that_localize_themselves_share_the_frame_of_the_board(tmp_path: Path) -> None:
    alone = ("world.seed=2", "task.max_views=1", "team.coverage=0.9", "team.killed_at=0.0")
    images = ("simulator.camera.width=320", "simulator.camera.height=240")
    own_poses = ("robot.pose_source=localization", "sharing.recovery=0.0")
    options = with_settings(TeamExplorationOptions(), (*SMALL, *alone, *images, *own_poses))
    exploration = TeamExploration(options, tmp_path)

    figures = exploration.run()

    assert figures["views"] == 2
    assert figures["same_hash"]
    assert max(figures["pose_error_rms"]) < 0.03
    assert figures["pose_nees"] < 3
    target = exploration.world.simulators[0].world.T_world_target
    assert target is not None
    np.testing.assert_allclose(exploration.T_world_map, target, atol=1e-12)
    one, two = (robot.member.replica for robot in exploration.robots if robot is not None)
    assert not one.aside and not two.aside  # the maps do not contradict
    assert figures["within_3_sigma"] > 0.9


def test_rovers_that_cannot_find_out_where_they_are_say_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def is_not_in_view(_: SimulatedRobot) -> None:
        raise PoseUnavailableError("the board is not in view")

    monkeypatch.setattr(SimulatedRobot, "begin", is_not_in_view)
    exploration = TeamExploration(with_settings(TeamExplorationOptions(), SMALL), tmp_path)
    with pytest.raises(ExplorationError, match="not in view; the board"):
        exploration.run()


def test_threads_run_one_at_a_time_by_their_clocks() -> None:
    turns = Turns(("a", "b"))
    order: list[tuple[str, float]] = []

    def task(name: str, step: float) -> None:
        for count in range(1, 4):
            order.append((name, step * (count - 1)))
            turns.pass_on(name, step * count)

    turns.run({"a": lambda: task("a", 1.0), "b": lambda: task("b", 2.5)})

    assert order == [("a", 0.0), ("b", 0.0), ("a", 1.0), ("a", 2.0), ("b", 2.5), ("b", 5.0)]


def test_a_task_that_fails_breaks_the_others_off() -> None:
    turns, seen = Turns(("a", "b")), []

    def fail() -> None:
        turns.pass_on("a", 1.0)
        raise ValueError("broken")

    def wait() -> None:
        try:
            for count in range(100):
                turns.pass_on("b", float(count))
        except SwitchedOff:
            seen.append(threading.current_thread().name)
            raise

    with pytest.raises(ValueError, match="broken"):
        turns.run({"a": fail, "b": wait})
    assert seen == ["b"]
    assert turns.failed


def test_a_task_is_switched_off_once() -> None:
    turns, count = Turns(("a",)), []

    def live() -> None:
        turns.switch_off("a")
        try:
            turns.pass_on("a", 1.0)
        except SwitchedOff:
            count.append(1)
        turns.pass_on("a", 2.0)

    turns.run({"a": live})
    assert count == [1]


def test_the_channel_loses_packets_and_takes_its_time() -> None:
    channel = Channel(2, Radio(rate=1e6, loss=0.2, delay=0.1), np.random.default_rng(0))
    for number in range(1000):
        channel.send(0, "kind", number, 100, now=0.0)
    assert channel.backlog(0.0) == pytest.approx(1000 * 160 * 8 / 1e6)
    assert not list(channel.deliver(0.1))
    heard = list(channel.deliver(10.0))
    assert len(heard) == pytest.approx(800, abs=40)
    assert [each.content for each in heard] == sorted(each.content for each in heard)
    assert {each.receiver for each in heard} == {1}
