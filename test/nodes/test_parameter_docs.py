"""Parameter files and tables say what the configurations say."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from infomap_ros.geometry.resources import find_share
from infomap_ros.nodes.parameter_docs import NODES, node_parameters, outdated_files


def test_parameter_files_and_tables_are_up_to_date() -> None:
    assert outdated_files() == [], "run python -m infomap_ros.nodes.parameter_docs"


def test_there_are_few_parameters() -> None:
    distinct = set().union(*(node_parameters(configs) for configs in NODES.values()))

    assert len(distinct) <= 163, len(distinct)


def test_what_tuning_names_are_parameters_of_the_node_that_it_names() -> None:
    named = 0
    for line in (find_share("config").parent / "docs" / "howto_tune.md").read_text().splitlines():
        *names, node = re.findall(r"`([a-z_.]+)`", line) or [""]
        if line.startswith("- ") and node in NODES:
            wanted = {name for name in names if f"`{name}`" in line.split(":", 1)[1]}
            assert wanted <= set(node_parameters(NODES[node])), line
            named += len(wanted)
    assert named >= 10


@pytest.mark.parametrize("node", NODES)
def test_no_two_configurations_share_a_parameter(node: str) -> None:
    parts = [set(node_parameters([entry])) for entry in NODES[node]]

    assert sum(len(part) for part in parts) == len(set().union(*parts))


@pytest.mark.parametrize("node", NODES)
def test_a_node_started_with_its_parameter_file_has_the_defaults(node: str) -> None:
    program = f"""
import rclpy
from rclpy.node import Node
from infomap_ros.nodes.parameter_docs import NODES
from infomap_ros.nodes.common.parameters import declare_config
rclpy.init(args=["--ros-args", "--params-file", {str(find_share(f"config/{node}.yaml"))!r}])
node = Node({node!r}, namespace="/robot1")
for kind, prefix in NODES[{node!r}]:
    assert declare_config(node, kind, prefix) == kind(), kind
print("read")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)

    assert done.stdout == "read\n", done.stderr


def test_parameter_files_can_be_changed(tmp_path: Path) -> None:
    text = find_share("config/map_fusion.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(text.replace("voxel_size: 0.05", "voxel_size: 0.02"))
    program = f"""
import rclpy
from rclpy.node import Node
from infomap_ros.mapping import VoxelMapConfig
from infomap_ros.nodes.common.parameters import declare_config
rclpy.init(args=["--ros-args", "--params-file", {str(tmp_path / "mine.yaml")!r}])
print(declare_config(Node("map_fusion"), VoxelMapConfig).voxel_size)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)

    assert done.stdout == "0.02\n", done.stderr
