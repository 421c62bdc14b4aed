"""The demo of a team, without its twelve processes: what they are told, and the map of all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from infomap_ros.errors import ProcessError
from infomap_ros.nodes.live import demo_team
from infomap_ros.nodes.live.demo_command import demo_world, task_parameters
from infomap_ros.nodes.live.kernels import STEPS, TEAM, compile_kernels
from infomap_ros.nodes.live.live_exploration import LiveTeam
from infomap_ros.simulation.team_world import TeamStart


def test_each_robot_is_told_who_it_is_and_where_it_starts(tmp_path: Path) -> None:
    given = {"simulator": {"world": "cave"}, "next_best_view": {"threads": 1}}
    starts = [TeamStart((0.0, float(y), 0.1), clear) for y, clear in ((-1, 0.6), (0, 2), (1, 0.7))]
    team = LiveTeam(tmp_path, starts, given, loss=0.2)

    nodes = [team._parameters[name] for name in team.names]
    assert team.names == ("rover1", "rover2", "rover3")
    assert [robot["map_fusion"]["robot_id"] for robot in nodes] == [1, 2, 3]
    assert {robot["next_best_view"]["team_map.simulated_loss"] for robot in nodes} == {0.2}
    assert [robot["simulator"]["publish_clock"] for robot in nodes] == [True, False, False]
    assert nodes[1]["simulator"]["teammates"] == ["rover1", "rover3"]
    assert nodes[1]["simulator"]["world"] == "cave"
    assert [robot["simulator"]["start"] for robot in nodes] == [list(each.place) for each in starts]
    assert [robot["next_best_view"]["start_clearance"] for robot in nodes] == [0.6, 0.9, 0.7]
    assert len({str(robot["map_fusion"]["map_file"]) for robot in nodes}) == 3
    reliable = "qos_overrides./rover2/camera_pose.subscription.reliability"
    assert nodes[1]["map_fusion"][reliable] == "reliable"


def test_without_a_board_each_begins_its_own_map_and_knows_the_others_tags(tmp_path: Path) -> None:
    starts = [TeamStart((0.0, float(y), 0.1), 1.0) for y in (-1, 1)]
    team = LiveTeam(tmp_path, starts, has_board=False)
    for number, name in enumerate(team.names, start=1):
        nodes = team._parameters[name]
        located, simulated = nodes["fiducial_localization"], nodes["simulator"]
        assert located["target.kind"] == "none" and located["follow_alignment"] is True
        assert not [key for key in located if key.startswith("target.") and "kind" not in key]
        assert simulated["world_target"] is False and simulated["teammate_ids"] == [3 - number]
        for key in ("robots", "ids", "poses"):
            assert located[f"team_tags.{key}"] == simulated[f"team_tags.{key}"]
        assert "tag" not in str(nodes["map_fusion"])  # where the frames are no node is told
        assert simulated["start"] not in [nodes[node] for node in nodes if node != "simulator"]
        assert Path(str(simulated["description"])).read_text().count("<box") > 6


def test_the_region_without_a_board_holds_in_the_map_of_each() -> None:
    world = demo_world("mars", 1, 4.0, has_board=False)
    assert world.T_world_target is None
    starts = [TeamStart((0.0, -0.5, 0.0), 1.0), TeamStart((0.5, 0.5, 0.0), 1.0)]
    task = task_parameters(world, {}, starts)
    np.testing.assert_allclose(task["task.region_low"][:2], [-2.5, -2.5])
    np.testing.assert_allclose(task["task.region_high"][:2], [2.0, 2.5])


@pytest.mark.parametrize("failing", ["", "map"])
def test_it_is_told_what_is_compiled_and_why_it_could_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    python, compiled, told = tmp_path / "python", tmp_path / "compiled", []
    fails = f'[ "$3" != "{failing}" ] || {{ echo out of disk; exit 3; }}'
    python.write_text(f"#!/bin/sh\n{fails}\necho $* >> {compiled}\n")
    python.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(python))

    if failing:
        with pytest.raises(ProcessError, match="out of disk"):
            compile_kernels(told.append, TEAM)
    else:
        compile_kernels(told.append, TEAM)

    stages = ["1 of 3, range", "2 of 3, map and localization", "3 of 3, planning and sharing"]
    assert told == stages[: 2 if failing else 3]
    if not failing:
        steps = [line.split()[-1] for line in compiled.read_text().splitlines()]
        assert steps[0] == "range"
        assert set(steps[1:3]) == {"map", "localization"}
        assert set(steps) == set(STEPS)


def test_an_impossible_world_ends_with_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    arguments = ["--out", str(tmp_path / "out"), "--world", "moon"]
    assert demo_team.main(arguments) == 1
    assert capfd.readouterr().err.strip().startswith("infomap demo-team: world: 'moon'")
