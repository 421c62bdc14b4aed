"""The launch file asks for executables and parameters that exist.

ROS's launch has no wheel, so a recorder of what the file asks for stands in for it.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from infomap_ros.geometry.resources import find_share
from infomap_ros.nodes.parameter_docs import NODES, node_parameters


class Recorder(SimpleNamespace):
    """Remembers the arguments of its construction."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(given=arguments, **named)

    def perform(self, context: dict[str, str]) -> str:
        return context[self.given[0]]


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    names = {
        "launch": ("LaunchDescription",),
        "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "Shutdown"),
        "launch.conditions": ("IfCondition",),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    for name, members in names.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member, Recorder)
        monkeypatch.setitem(sys.modules, name, module)
    path = find_share("launch/mapping.launch.py")
    spec = importlib.util.spec_from_file_location("mapping_launch", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def nodes_of(launch_file: ModuleType, **given: str) -> dict[str, Recorder]:
    """What is started with these launch arguments, by executable."""
    *arguments, start = launch_file.generate_launch_description().given[0]
    context = {a.given[0]: a.default_value for a in arguments} | given
    return {node.executable: node for node in start.function(context)}


def settings_of(node: Recorder) -> dict[str, Any]:
    return {k: v for part in node.parameters if isinstance(part, dict) for k, v in part.items()}


def test_a_live_robot_needs_two_nodes(launch_file: ModuleType) -> None:
    nodes = nodes_of(launch_file)

    assert set(nodes) == {"stereo_range", "map_fusion", "rviz2"}
    assert settings_of(nodes["map_fusion"])["use_sim_time"] is False


def test_a_bag_brings_its_player_and_its_clock(launch_file: ModuleType) -> None:
    nodes = nodes_of(launch_file, bag="bags/rover_rocks", namespace="robot1", loop="true")

    assert set(nodes) == {"stereo_range", "map_fusion", "bag_player", "rviz2"}
    assert settings_of(nodes["bag_player"])["loop"] is True
    assert Path(settings_of(nodes["bag_player"])["bag"]).samefile(find_share("bags/rover_rocks"))
    fusion = settings_of(nodes["map_fusion"])
    assert fusion["use_sim_time"] is True
    assert fusion["qos_overrides./robot1/points2.subscription.reliability"] == "reliable"


def test_every_parameter_that_is_set_exists_with_that_type(launch_file: ModuleType) -> None:
    nodes = nodes_of(launch_file, bag="bags/rover_rocks")
    del nodes["rviz2"]

    assert set(nodes) <= set(NODES)
    for name in nodes:
        known = node_parameters(NODES[name])
        for key, value in settings_of(nodes[name]).items():
            if key != "use_sim_time" and not key.startswith("qos_overrides"):
                kind = type(known[key][0])
                assert isinstance(value, list if kind is tuple else kind), key
        assert nodes[name].parameters[0] == str(find_share(f"config/{name}.yaml"))


def test_processes_get_the_environment_of_large_messages(
    launch_file: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)

    for node in nodes_of(launch_file).values():
        assert node.additional_env["FASTRTPS_DEFAULT_PROFILES_FILE"].endswith(".xml")


@pytest.mark.parametrize(
    ("given", "image"),
    [
        ({}, "left/image_raw"),
        ({"rectify": "false"}, "left/image_rect"),
        ({"source": "depth"}, "depth/image_rect"),
    ],
)
def test_the_player_waits_for_both_nodes(
    launch_file: ModuleType, given: dict[str, str], image: str
) -> None:
    nodes = nodes_of(launch_file, bag="bags/rover_rocks", **given)

    assert settings_of(nodes["bag_player"])["wait_for_subscribers"] == [image, "camera_pose"]
