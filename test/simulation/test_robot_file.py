"""The file of a robot says what was meant, to explore and to ROS."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from infomap_ros.cli.command_options import with_settings
from infomap_ros.errors import ConfigError, ResourceError
from infomap_ros.geometry.resources import find_share
from infomap_ros.simulation.body.robot import find_description, read_description
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions
from infomap_ros.simulation.robots.ready_robot import ready_robot
from infomap_ros.simulation.robots.robot_file import PARAMETERS, RobotFile

READY = sorted(path.stem for path in find_share("config/robots").glob("*.yaml"))


def write(folder: Path, **values: object) -> Path:
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}), encoding="utf-8")
    return path


def test_the_ready_robots_are_there() -> None:
    assert {"tiago", "tiago_pro", "stretch", "pr2", "ur5_on_base", "panda_on_base"} <= set(READY)


@pytest.mark.parametrize("name", READY)
def test_a_ready_file_is_as_it_is_written(name: str) -> None:
    file = RobotFile.read(name)
    again = RobotFile(
        file.description,
        file.setup,
        file.turn_gain,
        file.wheel_links,
        file.ground_links,
        file.assumed_joints,
        controllers=file.controllers,
    )
    section = yaml.safe_load(again.text(name))["/**"]["ros__parameters"]
    there = yaml.safe_load(find_share(f"config/robots/{name}.yaml").read_text("utf-8"))
    assert section == there["/**"]["ros__parameters"]
    assert set(section) <= PARAMETERS
    assert len(again.text(name).splitlines()) <= (16 if name == "stretch" else 15)


@pytest.mark.parametrize("name", READY)
def test_explore_takes_a_ready_file(name: str) -> None:
    file = RobotFile.read(name)
    options = with_settings(ExplorationOptions(), file.settings)
    setup = options.simulator.robot
    assert setup == file.setup
    assert options.simulator.drive.turn_gain == file.turn_gain
    ready = ready_robot(read_description(Path(options.world.description)), setup)
    assert ready.setup.arm_joints == file.setup.arm_joints
    assert len(ready.setup.wheels) >= 2


def test_a_section_of_the_simulator_counts_too(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "/**:\n  ros__parameters:\n    description: config/rover.urdf\n"
        "/**/simulator:\n  ros__parameters:\n    world: cave\n    robot.wheel_friction: 1\n"
        "/**/robot_driver:\n  ros__parameters:\n    base: cmd_vel\n",
        encoding="utf-8",
    )
    assert RobotFile.read(path).setup.wheel_friction == 1.0


def test_the_description_is_looked_for_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "mine.urdf").write_text("<robot name='r'/>", encoding="utf-8")
    file = RobotFile.read(write(tmp_path, description="mine.urdf"))
    assert file.description_path == (tmp_path / "mine.urdf").resolve()


@pytest.mark.parametrize(
    ("values", "culprit"),
    [
        ({"description": "a.urdf", "robot.casterz": ["a"]}, "robot.casters?"),
        ({"description": "a.urdf", "robot.cart": [1.0]}, "robot.cart"),
        ({"description": "a.urdf", "robot.baseline": "wide"}, "robot.baseline"),
        ({"description": "a.urdf", "drive.turn_gain": 9.0}, "turn_gain"),
        ({"base_frame": "base_link"}, "description"),
    ],
)
def test_errors_name_the_parameter(tmp_path: Path, values: dict[str, object], culprit: str) -> None:
    with pytest.raises(ConfigError) as caught:
        RobotFile.read(write(tmp_path, **values))
    assert culprit in str(caught.value)
    assert "mine.yaml" in str(caught.value)


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    for text in ("[", "- a", "/**: 3", "[" * 2000):
        (tmp_path / "bad.yaml").write_text(text, encoding="utf-8")
        with pytest.raises(ConfigError, match=r"bad\.yaml"):
            RobotFile.read(tmp_path / "bad.yaml")
    with pytest.raises(ResourceError, match=r"ready ones: .*tiago"):
        RobotFile.read("tiagoo")
    with pytest.raises(ResourceError, match="nowhere: install the package no_such"):
        find_description("package://no_such/robot.urdf")


def test_packages_of_ros_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "share" / "my_robot").mkdir(parents=True)
    urdf = tmp_path / "share" / "my_robot" / "a.urdf"
    urdf.write_text("<robot/>", encoding="utf-8")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert find_description("package://my_robot/a.urdf") == urdf.resolve()
