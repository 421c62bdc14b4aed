"""Parameters come from configuration classes and are validated by them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from infomap_ros.errors import ConfigError
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.localization.target.config import TargetConfig
from infomap_ros.localization.target.tag_board import TagBoardConfig
from infomap_ros.localization.target.tag_detector import TagTargetConfig
from infomap_ros.nodes.common.parameters import declare_config, is_settable, parameter_values
from infomap_ros.nodes.explorer import ExplorerNode
from infomap_ros.nodes.next_best_view import NextBestViewNode
from infomap_ros.nodes.parameter_docs import node_parameters
from infomap_ros.nodes.robot_driver import RobotDriverNode


@dataclass(frozen=True)
class Sample:
    size: float = parameter(0.05, "Edge length.", unit="m", low=0.001, high=10.0)
    count: int = parameter(3, "How many.", low=1)
    mode: str = parameter("fast", "Which.", choices=("fast", "exact"))
    use: bool = parameter(True, "Whether.")
    names: tuple[str, ...] = parameter(("a", "b"), "Names.")
    ranges: tuple[float, ...] = parameter((0.5, 4.0), "Near and far.", unit="m", low=0.0)

    def __post_init__(self) -> None:
        check_config(self)


def test_defaults_are_those_of_the_class(graph: Any) -> None:
    assert declare_config(graph.tester, Sample) == Sample()


def test_given_values_arrive_and_whole_numbers_fit_reals(graph: Any) -> None:
    node = graph.add(Node, "node", size=1, count=7, mode="exact", names=["x"], ranges=[1, 2])

    expected = Sample(1.0, 7, "exact", True, ("x",), (1.0, 2.0))
    assert declare_config(node, Sample) == expected
    assert node.get_parameter("size").value == 1.0


def test_descriptors_tell_description_unit_and_range(graph: Any) -> None:
    declare_config(graph.tester, Sample)

    size = graph.tester.describe_parameter("size")
    assert size.description == "Edge length. [m]"
    assert size.floating_point_range[0].from_value == 0.001
    assert size.floating_point_range[0].to_value == 10.0
    assert size.read_only
    count = graph.tester.describe_parameter("count")
    assert count.integer_range[0].from_value == 1
    mode = graph.tester.describe_parameter("mode")
    assert mode.additional_constraints == "one of fast, exact"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("size", 0.0),
        ("size", float("nan")),
        ("size", "big"),
        ("count", 0),
        ("count", 2.5),
        ("mode", "slow"),
        ("use", 1),
        ("names", [1, 2]),
        ("ranges", [-1.0]),
    ],
)
def test_an_impossible_value_is_refused_by_name(graph: Any, name: str, value: Any) -> None:
    node = graph.add(Node, "node", **{name: value})

    with pytest.raises(ConfigError, match=f"'{name}'"):
        declare_config(node, Sample)


def test_a_prefix_keeps_configurations_apart(graph: Any) -> None:
    node = graph.add(Node, "node", **{"near__size": 0.5, "far__size": 0.0})

    assert declare_config(node, Sample, "near.").size == 0.5
    with pytest.raises(ConfigError, match=r"'far\.size'"):
        declare_config(node, Sample, "far.")


def test_the_values_of_a_configuration_declare_it_again(graph: Any) -> None:
    pose, board = (1.0, 2.0, 0.5, 0.0, 0.0, 0.3), TagBoardConfig(columns=3)
    config = TargetConfig(pose_in_map=pose, tags=TagTargetConfig(board=board))
    values = parameter_values(config, "target.")
    assert values["target.pose_in_map"] == list(pose)
    assert values["target.tags.board.columns"] == 3
    node = graph.add(Node, "configured", **{k.replace(".", "__"): v for k, v in values.items()})
    assert declare_config(node, TargetConfig, "target.") == config


def test_a_new_value_is_judged_by_the_configuration_that_judges_the_first_one(graph: Any) -> None:
    """Nothing is taken of what is refused; two values that need each other are set together."""
    node = graph.add(ExplorerNode)
    task = partial(node.config, TaskConfig)
    before = task()

    def give(**values: Any) -> list[Any]:
        return [Parameter(f"task.{name}", value=value) for name, value in values.items()]

    (result,) = node.set_parameters(give(known_fraction=0.5))
    assert result.successful
    assert task() == replace(before, known_fraction=0.5)
    (result,) = node.set_parameters(give(region_low=[5.0, 5.0, 5.0]))
    assert not result.successful
    assert "'task.region_high'" in result.reason
    assert "above" in result.reason
    result = node.set_parameters_atomically(
        give(region_low=[5.0, 5.0, 5.0], region_high=[7.0, 8.0, 6.0])
    )
    assert result.successful
    assert task().region_low == (5.0, 5.0, 5.0)
    result = node.set_parameters_atomically(give(max_views=3, max_time=-1.0))
    assert not result.successful
    assert task().max_views == before.max_views
    (result,) = node.set_parameters([Parameter("map_frame", value="earth")])
    assert not result.successful
    assert "read-only" in result.reason


def test_a_strategy_that_there_is_not_is_refused(graph: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr("infomap_ros.nodes.next_best_view.prepare_kernels", lambda *_, **__: None)
    node = graph.add(NextBestViewNode)
    good, bad, unknown = (
        node.set_parameters([Parameter(name, value=value)])[0]
        for name, value in (("strategy", "raster"), ("strategy", "luck"), ("metric", "hope"))
    )
    assert good.successful
    assert not bad.successful
    assert "'strategy' is 'luck'" in bad.reason
    assert not unknown.successful
    assert node.config(ViewPlannerConfig).strategy == "raster"


@pytest.mark.parametrize("kind", [ExplorerNode, NextBestViewNode, RobotDriverNode])
def test_what_is_settable_is_there(kind: Any) -> None:
    names = node_parameters(kind.CONFIGS)
    for pattern in kind.SETTABLE:
        assert any(is_settable(name, [pattern]) for name in names), pattern
