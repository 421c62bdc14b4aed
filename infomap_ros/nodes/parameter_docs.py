"""Write down the parameters of the nodes from their configurations.

``python -m infomap_ros.nodes.parameter_docs`` writes the parameter files ``config/<node>.yaml``
and the tables of ``docs/parameters.md``; with ``--check`` it only says what is out of date.
"""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from infomap_ros.geometry.config import ParameterInfo, all_parameters
from infomap_ros.geometry.resources import find_share
from infomap_ros.nodes.bag_player import BagPlayerNode
from infomap_ros.nodes.dead_reckoning import DeadReckoningNode
from infomap_ros.nodes.explorer import ExplorerNode
from infomap_ros.nodes.fiducial_localization import FiducialLocalizationNode
from infomap_ros.nodes.map_fusion import MapFusionNode
from infomap_ros.nodes.next_best_view import NextBestViewNode
from infomap_ros.nodes.robot_driver import RobotDriverNode
from infomap_ros.nodes.simulator import SimulatorNode
from infomap_ros.nodes.stereo_range import StereoRangeNode
from infomap_ros.nodes.web_viewer import WebViewerNode

NODES = {
    "stereo_range": StereoRangeNode.CONFIGS,
    "fiducial_localization": FiducialLocalizationNode.CONFIGS,
    "map_fusion": MapFusionNode.CONFIGS,
    "bag_player": BagPlayerNode.CONFIGS,
    "simulator": SimulatorNode.CONFIGS,
    "next_best_view": NextBestViewNode.CONFIGS,
    "explorer": ExplorerNode.CONFIGS,
    "dead_reckoning": DeadReckoningNode.CONFIGS,
    "robot_driver": RobotDriverNode.CONFIGS,
    "web_viewer": WebViewerNode.CONFIGS,
}
_HEAD = """# Parameters of the nodes

Every parameter that a node declares. Made by `python -m infomap_ros.nodes.parameter_docs`; what a
node does, and which parameters to set first, is in [nodes.md](nodes.md).
"""


def node_parameters(
    configs: Sequence[tuple[type, str]],
) -> Mapping[str, tuple[Any, ParameterInfo]]:
    """All parameters of a node: name -> (default, info).

    Args:
        configs: configuration classes with the prefix of their parameters.
    """
    return {
        prefix + name: entry
        for config, prefix in configs
        for name, entry in all_parameters(config).items()
        if entry[1].public
    }


def parameter_table(configs: Sequence[tuple[type, str]]) -> str:
    """The parameters of a node as a Markdown table."""
    lines = ["| parameter | default | unit | range | meaning |", "| --- | --- | --- | --- | --- |"]
    for name, (default, info) in node_parameters(configs).items():
        meaning = info.description.replace("|", "\\|")
        lines.append(
            f"| `{name}` | `{_as_yaml(default)}` | {info.unit} | {_range(info)} | {meaning} |"
        )
    return "\n".join(lines)


def parameter_file(node: str, configs: Sequence[tuple[type, str]]) -> str:
    """The parameters of a node with their defaults as a ROS parameter file.

    Args:
        node: name of the node; the file is for nodes of this name in any namespace.
        configs: configuration classes with the prefix of their parameters.
    """
    lines = [
        f"# Parameters of {node}, all at their defaults. Made by",
        "# python -m infomap_ros.nodes.parameter_docs",
        f"/**/{node}:",
        "  ros__parameters:",
    ]
    for name, (default, info) in node_parameters(configs).items():
        unit = f" [{info.unit}]" if info.unit else ""
        limits = f" ({_range(info)})" if _range(info) else ""
        comment = textwrap.wrap(info.description + unit + limits, 92)
        lines += [f"    # {line}" for line in comment]
        lines.append(f"    {name}: {_as_yaml(default)}")
    return "\n".join(lines) + "\n"


def parameter_page() -> str:
    """All parameters of all nodes as a page of the docs, in Markdown."""
    parts = [_HEAD]
    for node, configs in NODES.items():
        parts.append(f"## {node}\n\n{parameter_table(configs)}\n")
    return "\n".join(parts)


def expected_files() -> dict[Path, str]:
    """Every file that is made here, with the content that it should have."""
    config = find_share("config")
    files = {config / f"{node}.yaml": parameter_file(node, c) for node, c in NODES.items()}
    return {**files, find_share("docs") / "parameters.md": parameter_page()}


def outdated_files() -> list[Path]:
    """Files that are not as they should be."""
    return [
        path
        for path, text in expected_files().items()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    ]


def _range(info: ParameterInfo) -> str:
    if info.choices:
        return ", ".join(info.choices)
    low = "" if info.low is None else f"{info.low:g}"
    high = "" if info.high is None else f"{info.high:g}"
    if low and high:
        return f"{low} to {high}"
    return f"from {low}" if low else (f"up to {high}" if high else "")


def _as_yaml(value: Any) -> str:
    """A default as ROS reads it: JSON is YAML, and a real number keeps its point."""
    return json.dumps(list(value) if isinstance(value, tuple) else value)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files; with ``--check`` return 1 when one is out of date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    check = parser.parse_args(arguments).check
    outdated = outdated_files()
    expected = expected_files()
    for path in outdated:
        print(f"{'out of date' if check else 'written'}: {path}")
        if not check:
            path.write_text(expected[path], encoding="utf-8")
    return int(check and bool(outdated))


if __name__ == "__main__":
    raise SystemExit(main())
