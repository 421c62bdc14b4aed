"""What docs say of nodes, topics and commands is so, of nodes that run and of launch files."""

from __future__ import annotations

import importlib
import re
import shlex
from collections import defaultdict
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest
import yaml
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from infomap_ros.geometry.config import all_parameters
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.interrupts import EXECUTABLES
from infomap_ros.nodes.parameter_docs import NODES
from infomap_ros.nodes.team.team_topics import OWN_FRAMES

from .conftest import Graph
from .test_launch import load
from .test_simulator import SMALL

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = [*sorted((REPOSITORY / "docs").glob("*.md")), REPOSITORY / "README.md"]
ROS_ARGUMENTS = {"__ns", "__node", *OWN_FRAMES}
FROM_ELSEWHERE = {"/clock", "/parameter_events", "/rosout", "/diagnostics"}
GIVEN: dict[str, dict[str, Any]] = {
    "bag_player": {"bag": str(REPOSITORY / "bags/rover_rocks")},
    "robot_driver": {"controllers": ["arm_controller: a, b"], "base": "cmd_vel"},
    "fiducial_localization": {
        "follow_alignment": True,
        "use_detections": find_spec("apriltag_msgs") is not None,
    },
    "stereo_range": {"rectify": False},
    "simulator": SMALL,
}
STARTED = [(name, GIVEN.get(name, {})) for name in EXECUTABLES]
STARTED += [("stereo_range", {"source": "depth", "color": True})]
STARTED += [("next_best_view", {"map_source": "octomap"})]


class End(NamedTuple):
    """A publisher or a subscription of a node."""

    node: str
    topic: str
    type_name: str
    publishes: bool
    profile: QoSProfile


class Inventory(NamedTuple):
    """What the nodes have; names as docs write them, relative or with ~."""

    ends: list[End]
    services: dict[str, str]  # name with the node's: type
    rights: dict[str, set[tuple[str, str]]]  # of each node: what it does, and with which name


def node_class(name: str) -> type[MonitoredNode]:
    module = importlib.import_module(f"infomap_ros.nodes.{name}")
    (found,) = (
        each
        for each in vars(module).values()
        if isinstance(each, type)
        and issubclass(each, MonitoredNode)
        and each.__module__ == module.__name__
    )
    return found


def type_of(message: type) -> str:
    package, kind, *_ = message.__module__.split(".")
    return f"{package}/{kind}/{message.__name__}"


@pytest.fixture(scope="module")
def inventory() -> Iterator[Inventory]:
    """Every node, started as it is, one after the other."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        graph = Graph()
        found = Inventory([], {}, defaultdict(set))
        for name, given in STARTED:
            node = graph.add(node_class(name), **given)
            own, space = f"{graph.namespace}/{name}/", f"{graph.namespace}/"

            def short(topic: str, own: str = own, space: str = space) -> str:
                return topic.replace(own, "~/").removeprefix(space)

            for publishes, those in ((True, node.publishers), (False, node.subscriptions)):
                for each in those:
                    topic = short(each.topic if publishes else each.topic_name)
                    kind = type_of(each.msg_type)
                    found.ends.append(End(name, topic, kind, publishes, each.qos_profile))
                    found.rights[name].add(("publish" if publishes else "subscribe", topic))
            asks = (("reply", node.services), ("request", node.clients))
            names = ((what, short(each.srv_name)) for what, those in asks for each in those)
            found.rights[name] |= {
                (what, called.replace(f"{name}/", "~/"))
                for what, called in names
                if "/_action/" not in called
            }
            for service in node.services:
                called = short(service.srv_name).replace("~", name)
                found.services[f"/{called}"] = type_of(service.srv_type)
            graph.remove(node)
        yield found
        graph.close()


def shared_topics() -> list[tuple[list[str], str, str, str]]:
    """Rows of the tables of shared topics: names, type, depth (empty for an input), content."""
    text = (REPOSITORY / "docs/nodes.md").read_text("utf-8")
    text = text[text.index("## Shared topics") : text.index("## stereo_range")]
    rows = []
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if line.startswith("| `"):
            names = re.findall(r"`([^`]+)`", cells[0])
            depth = cells[2] if len(cells) == 4 else ""
            rows.append((names, cells[1], depth, cells[-1]))
    return rows


def test_every_shared_topic_is_there_with_its_type(inventory: Inventory) -> None:
    kinds = {end.topic: end.type_name for end in inventory.ends}
    wrong = [
        f"{name}: {kinds.get(name)}, docs: {types}"
        for names, types, _, _ in shared_topics()
        for name, said in zip(names, _types(names, types), strict=True)
        if kinds.get(name, "").rpartition("/")[2] != said
    ]
    print(*wrong, sep="\n")
    assert wrong == []


def _types(names: list[str], types: str) -> list[str]:
    """One for all, or one for each."""
    parts = [part.strip().rpartition("/")[2] for part in types.split(",")]
    return parts * len(names) if len(parts) == 1 else [*parts, *parts[:1] * (len(names) - 2)]


def test_the_policy_of_sros2_allows_what_nodes_do_and_no_more(inventory: Inventory) -> None:
    root = ElementTree.parse(REPOSITORY / "config/sros2_policy.xml").getroot()
    allowed = {
        profile.attrib["node"]: {
            (what, name.text)
            for rule in profile
            for what in rule.attrib.keys() - {"call"}  # controllers, of each robot its own
            for name in rule
        }
        for profile in root.iter("profile")
    }
    assert set(allowed) == set(EXECUTABLES) - {"bag_player", "simulator"}
    everyone = {("publish", "/rosout"), ("subscribe", "/clock")}
    unrectified = {("subscribe", f"{side}/image_raw") for side in ("left", "right")}
    of_depth = {("subscribe", f"{name}/image_rect") for name in ("depth", "rgb")}
    of_depth |= {("subscribe", "depth/camera_info")}
    images = unrectified | of_depth
    others = {"stereo_range": unrectified, "fiducial_localization": images}
    for node, rights in allowed.items():
        assert rights == inventory.rights[node] | everyone | others.get(node, set()), node


SENSOR_DATA = {"points2", "camera_pose", "camera_pose_uncertainty"}


def test_quality_of_service_is_that_of_the_table(inventory: Inventory) -> None:
    """Inputs of robots are best effort but for the last two; else reliable, with that depth."""
    inputs = [row for row in shared_topics() if not row[2]]
    best_effort = {name for names, *_ in inputs[:-2] for name in names}
    depths = {name: row[2] for row in shared_topics() for name in row[0] if row[2]}
    wrong = []
    for end in inventory.ends:
        if end.topic not in {*best_effort, *depths}:
            continue
        lossy = not end.publishes and end.topic in best_effort | SENSOR_DATA
        profile = end.profile
        if (profile.reliability is ReliabilityPolicy.BEST_EFFORT) != lossy:
            wrong.append(f"{end.node} {end.topic}: {profile.reliability.name}")
        numbers = [int(number) for number in re.findall(r"\d+", depths.get(end.topic, ""))]
        if numbers and end.publishes and profile.depth != numbers[0]:
            wrong.append(f"{end.node} publishes {end.topic}: depth {profile.depth}, {numbers}")
        if len(numbers) > 1 and not end.publishes and profile.depth != numbers[1]:
            wrong.append(f"{end.node} hears {end.topic}: depth {profile.depth}, {numbers}")
    print(*wrong, sep="\n")
    assert wrong == []


def test_what_docs_call_latched_is_what_is_latched(inventory: Inventory) -> None:
    text = (REPOSITORY / "docs/nodes.md").read_text("utf-8")
    said = {}
    for section in re.split(r"^## ", text, flags=re.MULTILINE):
        node = section.split(maxsplit=1)[0]
        for item in re.findall(r"^- (`.+?)(?=^- |^$)", section + "\n\n", re.M | re.S):
            head = item.split("):")[0]
            for topic in re.findall(r"`([^`]+)`", head):
                said[node, topic] = "latched" in head
    checked, wrong = 0, []
    for end in inventory.ends:
        if (end.node, end.topic) in said and end.publishes and end.node in EXECUTABLES:
            is_latched = end.profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
            known = said[end.node, end.topic] or "Maps are latched" in _section(text, end.node)
            checked += 1
            if (is_latched and not known) or (said[end.node, end.topic] and not is_latched):
                wrong.append(f"{end.node} {end.topic}: latched is {is_latched}")
    print(*wrong, sep="\n")
    assert wrong == []
    assert checked > 15


def _section(text: str, node: str) -> str:
    return text[text.index(f"## {node}") :].split("\n## ")[0]


def commands() -> list[tuple[str, list[str]]]:
    """Page and words of each command of ROS in the docs."""
    found = []
    for page in PAGES:
        text = page.read_text("utf-8").replace("\\\n", " ")
        lines = re.findall(r"^ {4,}(.*)$", text, re.MULTILINE) + re.findall(r"`([^`]+)`", text)
        for line in lines:
            match = re.search(r"(ros2 (?:run|launch|topic|service|bag|param) .*)", line)
            if match:
                words = shlex.split(match[1].split(" > ")[0], comments=True)
                if len(words) > 3:
                    found.append((page.name, words))
    return found


def problem_of(words: list[str], inventory: Inventory, files: dict[str, ModuleType]) -> str:
    """What a command names that is not there; empty where all is."""
    topics = {end.topic for end in inventory.ends}
    verb, rest = words[1], words[2:]
    if verb == "launch" and rest[0] == "infomap_ros":
        return _problem_of_launch(files.get(rest[1]), rest[2:])
    if verb == "run" and rest[0] == "infomap_ros" and rest[1] != "infomap":
        return _problem_of_run(rest[1], rest[2:], inventory)
    if verb == "service" and inventory.services.get(rest[1]) != rest[2]:
        return f"service {rest[1:3]}"
    if verb in ("topic", "bag"):
        named = [word.removeprefix("/") for word in rest if word.startswith("/")]
        return ", ".join(set(named) - topics - {"tf", "tf_static"})
    if verb == "param" and rest[0] == "set":
        node, name = rest[1].removeprefix("/"), rest[2]
        return "" if _knows(node, name, rest[3]) else f"{node} {name}"
    return ""


def _problem_of_launch(module: ModuleType | None, given: list[str]) -> str:
    if module is None:
        return "no such launch file"
    *arguments, _ = module.generate_launch_description().given[0]
    known = {argument.given[0] for argument in arguments}
    pairs = [word.split(":=")[0] for word in given if ":=" in word]
    return ", ".join(set(pairs) - known)


def _problem_of_run(name: str, given: list[str], inventory: Inventory) -> str:
    if name not in NODES:
        return f"no executable {name}"
    heard = {end.topic for end in inventory.ends if end.node == name}
    words = pairwise(given)
    for kind, (left, _, right) in ((k, w.partition(":=")) for k, w in words if k in ("-p", "-r")):
        if kind == "-p" and not _knows(name, left, right):
            return f"parameter {left} of {name}, as {right}"
        if kind == "-r" and left not in heard | ROS_ARGUMENTS:
            return f"topic {left} of {name}"
    return ""


def _knows(node: str, name: str, value: str) -> bool:
    """Whether a node has such a parameter or setting, and this is of its type."""
    known = {
        prefix + key: default
        for config, prefix in NODES[node]
        for key, (default, _) in all_parameters(config).items()
    }
    kind, given = type(known.get(name)), yaml.safe_load(value)
    return name in known and isinstance(given, list if kind is tuple else kind)


def test_commands_in_docs_name_what_there_is(
    inventory: Inventory, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = {f"{name}.launch.py": load(name, monkeypatch) for name in ("mapping", "robot", "team")}
    found = commands()
    wrong = [
        f"{page}: {' '.join(words)}: {problem}"
        for page, words in found
        if (problem := problem_of(words, inventory, files))
    ]
    print(*wrong, sep="\n")
    assert wrong == []
    assert len(found) > 25


@pytest.mark.parametrize(
    "command",
    [
        "ros2 launch infomap_ros mapping.launch.py bagg:=x",
        "ros2 launch infomap_ros mappping.launch.py bag:=x",
        "ros2 run infomap_ros stereo_rang --ros-args",
        "ros2 run infomap_ros map_fusion --ros-args -p voxelsize:=0.05",
        "ros2 run infomap_ros map_fusion --ros-args -p voxel_size:=wide",
        "ros2 run infomap_ros map_fusion --ros-args -r points:=/velodyne_points",
        "ros2 service call /explorer/begin std_srvs/srv/Trigger",
        "ros2 service call /map_fusion/clear_region std_srvs/srv/Trigger",
        "ros2 topic echo /exploration_state",
    ],
)
def test_a_slip_in_a_command_is_found(
    command: str, inventory: Inventory, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = {"mapping.launch.py": load("mapping", monkeypatch)}
    assert problem_of(shlex.split(command), inventory, files)
