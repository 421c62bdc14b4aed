"""Settings of a command line are applied together, and refused by the name that the user typed."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from infomap_ros.cli.command_options import settings_table, with_settings
from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter


@dataclass(frozen=True)
class Arm:
    """As many angles as joints."""

    joints: tuple[str, ...] = parameter(("a", "b"), "Joints.")
    home: tuple[float, ...] = parameter((0.0, 1.0), "Angles.", unit="rad")
    limits: tuple[float, ...] = parameter((), "Of the joints.", unit="rad")

    def __post_init__(self) -> None:
        check_config(self)
        if len(self.home) != len(self.joints):
            raise ConfigError("home", self.home, f"{len(self.joints)} numbers")


@dataclass(frozen=True)
class Robot:
    arm: Arm = field(default_factory=Arm)
    speed: float = parameter(0.5, "Of the base.", unit="m/s", low=0.0, high=2.0)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class Options:
    robot: Robot = field(default_factory=Robot)


@pytest.mark.parametrize("turned", [False, True])
def test_settings_that_depend_on_each_other_may_come_in_any_order(turned: bool) -> None:
    settings = ["robot.arm.joints=x,y,z", "robot.arm.home=0.1,0.2,0.3"]
    arm = with_settings(Options(), settings[::-1] if turned else settings).robot.arm
    assert arm == Arm(("x", "y", "z"), (0.1, 0.2, 0.3))


def test_of_two_values_the_last_counts() -> None:
    assert with_settings(Options(), ["robot.speed=1", "robot.speed=0.2"]).robot.speed == 0.2


def test_an_empty_value_is_an_empty_list() -> None:
    arm = with_settings(Options(), ["robot.arm.joints=", "robot.arm.home="]).robot.arm
    assert arm == Arm((), ())


def test_elements_of_a_list_that_is_empty_by_default_are_numbers() -> None:
    assert with_settings(Options(), ["robot.arm.limits=1.5,-2"]).robot.arm.limits == (1.5, -2.0)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("robot.arm.limits=a", "--set robot.arm.limits is 'a', expected a number"),
        ("robot.arm.joints=x", r"--set robot.arm.home is \(0.0, 1.0\), expected 1 numbers"),
        ("robot.speed=3", r"--set robot.speed is 3.0, expected .* at most 2 m/s"),
        ("robot.sped=3", r"did you mean robot.speed\?"),
        ("speed=3", r"did you mean robot.speed\?"),
        ("robot.speed", "--set is 'robot.speed', expected SECTION.NAME=VALUE"),
    ],
)
def test_what_is_refused_is_named_as_it_was_typed(setting: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        with_settings(Options(), [setting])


def test_an_option_that_stands_for_a_setting_is_named_instead() -> None:
    with pytest.raises(ConfigError, match=r"--speed is 3\.0"):
        with_settings(Options(), ["robot.speed=3"], {"robot.speed": "--speed"})


def test_the_table_can_be_typed_back() -> None:
    lines = settings_table(Options()).splitlines()
    assert lines[0] == "robot.speed=0.5  [m/s, 0 to 2]  Of the base."
    assert with_settings(Options(), [line.split("  ")[0] for line in lines]) == Options()
