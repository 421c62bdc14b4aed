"""The launch files ask for executables and parameters that exist.

ROS's launch has no wheel, so a recorder of what a file asks for stands in for it.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import yaml

from infomap_ros.errors import ConfigError, ResourceError
from infomap_ros.geometry.config import all_parameters, build_config
from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.arm.controller_trajectories import read_controllers
from infomap_ros.nodes.driving.driver_config import RobotDriverConfig
from infomap_ros.nodes.parameter_docs import NODES, node_parameters
from infomap_ros.simulation.robots.robot_file import PARAMETERS

EXPLORING = ("stereo_range", "map_fusion", "fiducial_localization", "next_best_view", "explorer")


class Recorder(SimpleNamespace):
    """Remembers the arguments of its construction."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(given=arguments, **named)

    def perform(self, context: dict[str, str]) -> str:
        return context[self.given[0]]


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return load("mapping", monkeypatch)


@pytest.fixture
def exploration(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return load("robot", monkeypatch)


def load(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    names = {
        "launch": ("LaunchDescription",),
        "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "Shutdown"),
        "launch.conditions": ("IfCondition",),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    for module_name, members in names.items():
        module = ModuleType(module_name)
        for member in members:
            setattr(module, member, Recorder)
        monkeypatch.setitem(sys.modules, module_name, module)
    path = find_share(f"launch/{name}.launch.py")
    spec = importlib.util.spec_from_file_location(f"{name}_launch", path)
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


def test_a_live_robot_needs_three_nodes(launch_file: ModuleType) -> None:
    nodes = nodes_of(launch_file)

    assert set(nodes) == {"stereo_range", "map_fusion", "fiducial_localization", "rviz2"}
    assert settings_of(nodes["map_fusion"])["use_sim_time"] is False


def test_a_bag_brings_its_player_and_its_clock(launch_file: ModuleType) -> None:
    nodes = nodes_of(launch_file, bag="bags/rover_rocks", namespace="robot1", loop="true")

    own = {"stereo_range", "map_fusion", "fiducial_localization", "bag_player"}
    assert set(nodes) == {*own, "rviz2"}
    player = settings_of(nodes["bag_player"])
    assert player["left_out"] == player_of_poses(launch_file, localization="odometry")
    assert player_of_poses(launch_file, localization="pose") == []
    assert settings_of(nodes["bag_player"])["loop"] is True
    assert Path(settings_of(nodes["bag_player"])["bag"]).samefile(find_share("bags/rover_rocks"))
    fusion = settings_of(nodes["map_fusion"])
    assert fusion["use_sim_time"] is True
    assert fusion["qos_overrides./robot1/points2.subscription.reliability"] == "reliable"


def test_a_page_is_served_where_it_is_wanted(
    launch_file: ModuleType, exploration: ModuleType
) -> None:
    for module in (launch_file, exploration):
        given = {"web": "true", "robot_id": "2", "frame_prefix": "mine/"}
        nodes = nodes_of(module, **given)
        settings = settings_of(nodes["web_viewer"])

        assert "web_viewer" not in nodes_of(module)
        assert settings["robot_id"] == 2
        assert settings["base_frame"] == "mine/base_link"
        assert ("team/map_updates", "/team/map_updates") in nodes["web_viewer"].remappings
        check_settings(nodes)


def player_of_poses(launch_file: ModuleType, **given: str) -> list[str]:
    """Topics of the bag that are left out because a node makes them anew."""
    nodes = nodes_of(launch_file, bag="bags/rover_rocks", **given)
    left_out: list[str] = settings_of(nodes["bag_player"])["left_out"]
    return left_out


def check_settings(nodes: dict[str, Recorder]) -> None:
    """Every parameter or setting that is set exists, with that type."""
    nodes = {name: node for name, node in nodes.items() if name != "rviz2"}
    assert set(nodes) <= set(NODES)
    for name, node in nodes.items():
        known = {
            prefix + field: default
            for config, prefix in NODES[name]
            for field, (default, _) in all_parameters(config).items()
        }
        for key, value in settings_of(node).items():
            if key != "use_sim_time" and not key.startswith("qos_overrides"):
                kind = type(known[key])
                assert isinstance(value, list if kind is tuple else kind), key
        assert node.parameters[0] == str(find_share(f"config/{name}.yaml"))


def test_every_parameter_that_is_set_exists_with_that_type(launch_file: ModuleType) -> None:
    check_settings(nodes_of(launch_file, bag="bags/rover_rocks"))


@pytest.mark.parametrize("simulator", ["true", "false"])
@pytest.mark.parametrize("localization", ["fiducials", "odometry", "pose"])
def test_exploring_sets_parameters_that_exist(
    exploration: ModuleType, simulator: str, localization: str
) -> None:
    check_settings(nodes_of(exploration, simulator=simulator, localization=localization))


def test_exploring_in_simulation_takes_its_clock_and_loses_nothing(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration, simulator="true", world="cave", seed="4", namespace="robot1")

    assert set(nodes) == {*EXPLORING, "simulator", "rviz2"}
    world = settings_of(nodes["simulator"])
    assert (world["world"], world["world_seed"]) == ("cave", 4)
    assert world["publish_camera_pose"] is False
    for name in EXPLORING:
        assert settings_of(nodes[name])["use_sim_time"] is True
    explorer = settings_of(nodes["explorer"])
    assert explorer["autostart"] is True
    assert explorer["qos_overrides./robot1/camera_pose.subscription.reliability"] == "reliable"


def test_a_driver_moves_the_simulated_rover_by_actions(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration, simulator="true", driver="true")

    check_settings(nodes)
    assert set(nodes) == {*EXPLORING, "robot_driver", "simulator", "rviz2"}
    assert settings_of(nodes["simulator"])["commands"] == "actions"
    assert settings_of(nodes["robot_driver"])["controllers"] == [
        "arm_controller: arm_pan_joint, arm_shoulder_joint, arm_elbow_joint, arm_wrist_joint"
    ]


def test_a_driver_of_a_robot_takes_its_controllers_from_the_file(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration, robot="tiago")

    assert set(nodes) == {*EXPLORING, "robot_driver", "rviz2"}
    assert "controllers" not in settings_of(nodes["robot_driver"])
    for name in (*EXPLORING, "robot_driver"):
        assert nodes[name].parameters[1] == str(find_share("config/robots/tiago.yaml"))


def test_a_simulated_robot_has_the_simulator_s_controllers(exploration: ModuleType) -> None:
    given = {"robot": "tiago", "parameters": "mine.yaml"}
    nodes = nodes_of(exploration, simulator="true", driver="true", **given)
    file, simulator, driver = find_share("config/robots/tiago.yaml"), "simulator", "robot_driver"

    (controller,) = settings_of(nodes[driver])["controllers"]
    assert controller.startswith("arm_controller: torso_lift_joint, arm_1_joint")
    for name in (simulator, driver):
        parameters = nodes[name].parameters
        assert parameters.index(str(file)) < parameters.index(settings_part(nodes[name]))
        assert parameters[-1] == "mine.yaml"


def settings_part(node: Recorder) -> dict[str, Any]:
    """What the launch file sets, and which counts for more than what stands before it."""
    (part,) = [part for part in node.parameters if isinstance(part, dict)]
    return part


def test_a_robot_s_frames_get_its_prefix(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration, robot="tiago", frame_prefix="mine/")

    assert settings_of(nodes["next_best_view"])["base_frame"] == "mine/base_footprint"


def test_a_robot_that_there_is_not_is_named(exploration: ModuleType) -> None:
    with pytest.raises(ResourceError, match=r"'tigo'; ready ones: .*tiago"):
        nodes_of(exploration, robot="tigo")


READY = sorted(path.stem for path in find_share("config/robots").glob("*.yaml"))


@pytest.mark.parametrize("name", READY)
def test_the_robot_files_hold_parameters_that_nodes_accept(name: str) -> None:
    path = find_share(f"config/robots/{name}.yaml")
    text = path.read_text("utf-8")
    told = {key: each["ros__parameters"] for key, each in yaml.safe_load(text).items()}
    driver = {"controllers": told["/**"]["controllers"]} | told.get("/**/robot_driver", {})
    config = build_config(RobotDriverConfig, {k: _plain(v) for k, v in driver.items()})
    joints = {joint for each in read_controllers(config.controllers).values() for joint in each}
    assert set(told["/**"]["arm_joints"]) == joints
    assert set(told["/**"]) <= set(node_parameters(NODES["next_best_view"])) | PARAMETERS


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def test_exploring_with_a_robot_leaves_its_quality_of_service(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration)

    assert set(nodes) == {*EXPLORING, "robot_driver", "rviz2"}
    for name in EXPLORING:
        settings = settings_of(nodes[name])
        assert settings["use_sim_time"] is False
        assert not [key for key in settings if key.startswith("qos_overrides")]
    assert settings_of(nodes["explorer"])["autostart"] is False


def test_parameters_of_ones_own_count_most(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration, parameters="mine.yaml")

    for name in EXPLORING:
        assert nodes[name].parameters[-1] == "mine.yaml"


def test_odometry_takes_the_place_of_the_pose(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration, simulator="true", localization="odometry")

    assert settings_of(nodes["simulator"])["publish_camera_pose"] is False
    assert "dead_reckoning" in nodes
    assert "fiducial_localization" not in nodes


def test_a_pose_from_elsewhere_needs_no_localization(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration, simulator="true", localization="pose")

    assert settings_of(nodes["simulator"])["publish_camera_pose"] is True
    assert not {"dead_reckoning", "fiducial_localization"} & set(nodes)


def test_planner_and_explorer_have_the_same_task(exploration: ModuleType) -> None:
    given = {"region_low": "-1 -2.5 0", "region_high": "[4.0, 5, 2.0]", "max_views": "7"}
    nodes = nodes_of(exploration, **given)
    tasks = [
        {k: v for k, v in settings_of(nodes[name]).items() if k.startswith("task.")}
        for name in ("next_best_view", "explorer")
    ]

    assert tasks[0] == tasks[1]
    assert tasks[0]["task.region_low"] == [-1.0, -2.5, 0.0]
    assert tasks[0]["task.region_high"] == [4.0, 5.0, 2.0]
    assert tasks[0]["task.max_views"] == 7


def test_processes_get_the_environment_of_large_messages(
    launch_file: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)

    for node in nodes_of(launch_file).values():
        assert node.additional_env["FASTRTPS_DEFAULT_PROFILES_FILE"].endswith(".xml")


@pytest.mark.parametrize(
    ("given", "images"),
    [
        ({}, ["left/image_raw", "left/image_raw"]),
        ({"rectify": "false"}, ["left/image_rect", "left/image_rect"]),
        ({"source": "depth"}, ["depth/image_rect", "depth/image_rect"]),
        ({"localization": "odometry"}, ["left/image_raw"]),
    ],
)
def test_the_player_waits_for_all_nodes(
    launch_file: ModuleType, given: dict[str, str], images: list[str]
) -> None:
    nodes = nodes_of(launch_file, bag="bags/rover_rocks", **given)

    wanted = settings_of(nodes["bag_player"])["wait_for_subscribers"]
    assert wanted == [*images, "points2", "camera_pose"]


@pytest.mark.parametrize("name", ["mapping", "robot"])
def test_a_member_of_a_team_shares_the_topics_of_the_team(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = {"namespace": "robot2", "robot_id": "2", "team": "1,2", "team_key": "key"}
    nodes = nodes_of(load(name, monkeypatch), **given)

    check_settings(nodes)
    fusion = nodes["map_fusion"]
    shared = dict(fusion.remappings)
    assert "map_updates" not in shared
    assert shared["team/map_updates"] == "/team/map_updates"
    assert shared["team/agents"] == "/team/agents"
    settings = settings_of(fusion)
    assert (settings["robot_id"], settings["team"], settings["team_key"]) == (2, [1, 2], "key")


def test_a_robot_alone_keeps_its_topics_and_has_frames_of_its_own(exploration: ModuleType) -> None:
    for node in nodes_of(exploration, namespace="robot2").values():
        assert dict(node.remappings) == {"/tf": "tf", "/tf_static": "tf_static"}
        assert "robot_id" not in settings_of(node)


@pytest.mark.parametrize("name", ["mapping", "robot"])
def test_nodes_have_time_to_save_before_they_are_killed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes = nodes_of(load(name, monkeypatch), map_file="here.infomap", autosave="7")

    for node in own(nodes):
        assert float(node.sigterm_timeout) >= 15.0
        assert float(node.sigkill_timeout) >= 5.0
    settings = settings_of(nodes["map_fusion"])
    assert (settings["map_file"], settings["autosave_period"]) == ("here.infomap", 7.0)


def own(nodes: dict[str, Recorder]) -> list[Recorder]:
    return [node for name, node in nodes.items() if name != "rviz2"]


def test_time_is_that_of_the_clock_where_it_is_wanted(exploration: ModuleType) -> None:
    for given, expected in (({"use_sim_time": "true"}, True), ({}, False)):
        for node in own(nodes_of(exploration, **given)):
            assert settings_of(node)["use_sim_time"] is expected


@pytest.mark.parametrize(
    ("given", "topic"),
    [
        ({}, "/left/image_raw"),
        ({"rectify": "false"}, "/left/image_rect"),
        ({"source": "depth"}, "/depth/image_rect"),
    ],
)
def test_the_player_is_paced_by_an_image_of_the_bag(
    launch_file: ModuleType, given: dict[str, str], topic: str
) -> None:
    nodes = nodes_of(launch_file, bag="bags/rover_rocks", acknowledged="true", **given)

    assert settings_of(nodes["bag_player"])["paced_topic"] == topic


def test_a_depth_camera_on_the_arm_explores(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration, camera="realsense_depth")

    check_settings(nodes)
    for name in ("stereo_range", "fiducial_localization", "next_best_view"):
        assert settings_of(nodes[name])["source"] == "depth"
    info = "camera/camera/aligned_depth_to_color/camera_info"
    for name in ("explorer", "robot_driver"):
        assert dict(nodes[name].remappings)["left/camera_info"] == info


def test_points_from_elsewhere_need_no_camera(launch_file: ModuleType) -> None:
    nodes = nodes_of(launch_file, source="points", localization="pose")

    assert set(nodes) == {"map_fusion", "rviz2"}
    with pytest.raises(ConfigError, match=r"localization.*odometry or pose where source is points"):
        nodes_of(launch_file, source="points")


def test_a_camera_by_name_brings_its_topics(launch_file: ModuleType) -> None:
    nodes = nodes_of(launch_file, camera="realsense_depth")

    for name in ("stereo_range", "fiducial_localization"):
        settings, topics = settings_of(nodes[name]), dict(nodes[name].remappings)
        assert (settings["source"], settings["rectify"]) == ("depth", False)
        assert topics["depth/image_rect"].endswith("aligned_depth_to_color/image_raw")
    pair = dict(nodes_of(launch_file, camera="zed")["stereo_range"].remappings)
    assert pair["right/camera_info"] == "zed/zed_node/right/camera_info"
    with pytest.raises(ConfigError, match="realsense"):
        nodes_of(launch_file, camera="pinhole")


def test_frames_with_a_prefix_share_one_tf(exploration: ModuleType) -> None:
    nodes = nodes_of(exploration, frame_prefix="robot1/")

    check_settings(nodes)
    for node in own(nodes):
        assert "/tf" not in dict(node.remappings)
    settings = settings_of(nodes["fiducial_localization"])
    assert settings["base_frame"] == "robot1/base_link"
    assert settings["odom_frame"] == "robot1/odom"
    assert settings["frame_prefix"] == settings_of(nodes["map_fusion"])["frame_prefix"] == "robot1/"


def test_nodes_come_back_and_log_as_wanted(launch_file: ModuleType) -> None:
    nodes = nodes_of(launch_file, bag="bags/rover_rocks", respawn="true", log_level="debug")

    for node in own(nodes):
        assert node.respawn is (node.executable != "bag_player")
        assert node.ros_arguments == ["--log-level", "debug"]


def test_compressed_images_have_the_names_of_image_transport(launch_file: ModuleType) -> None:
    nodes = nodes_of(launch_file, image_transport="compressed")
    for name in ("stereo_range", "fiducial_localization"):
        topics = dict(nodes[name].remappings)
        assert topics["left/image_raw"] == "left/image_raw/compressed"
        assert "left/camera_info" not in topics
    given = {"camera": "realsense_depth", "image_transport": "compressed"}
    topics = dict(nodes_of(launch_file, **given)["stereo_range"].remappings)
    place = "camera/camera/aligned_depth_to_color"
    assert topics["depth/image_rect"] == f"{place}/image_raw/compressedDepth"
    assert topics["depth/camera_info"] == f"{place}/camera_info"


def test_a_team_is_launched_with_a_robot_in_each_namespace(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    *arguments, start = load("team", monkeypatch).generate_launch_description().given[0]
    context = {a.given[0]: a.default_value for a in arguments}
    given = {"robots": "3", "size": "8", "max_views": "2", "out": str(tmp_path)}
    nodes = start.function(context | given)
    robots = {
        space: {n.executable: n for n in nodes if n.namespace == space}
        for space in ("rover1", "rover2", "rover3")
    }
    assert sum(map(len, robots.values())) == len(nodes)
    places = []
    for number, own in enumerate(robots.values(), 1):
        assert {*EXPLORING, "simulator"} <= set(own)
        check_settings(own)
        fusion, simulator = settings_of(own["map_fusion"]), settings_of(own["simulator"])
        assert (fusion["robot_id"], fusion["team"]) == (number, [1, 2, 3])
        assert Path(fusion["map_file"]).parent == tmp_path / f"rover{number}"
        assert len(simulator["teammates"]) == 2
        assert simulator["publish_clock"] == (number == 1)
        assert settings_of(own["explorer"])["task.max_views"] == 2
        assert settings_of(own["fiducial_localization"])["target.kind"] == "tags"
        remaps = dict(own["map_fusion"].remappings)
        assert remaps["team/map_updates"] == "/team/map_updates"
        assert remaps["/tf"] == "tf"
        places.append(tuple(simulator["start"]))
    assert len(set(places)) == 3
