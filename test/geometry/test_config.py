"""Configuration fields refuse what is out of range and describe themselves."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InfomapError
from infomap_ros.geometry.config import (
    all_parameters,
    build_config,
    check_config,
    parameter,
    parameters_of,
)


@dataclass(frozen=True)
class Example:
    length: float = parameter(0.5, "Some length.", unit="m", low=0.1, high=2.0)
    count: int = parameter(3, "Some number.", low=1)
    enabled: bool = parameter(True, "A switch.")
    mode: str = parameter("near", "A choice.", choices=("near", "far"))
    name: str = parameter("", "Free text.")
    levels: tuple[float, ...] = parameter((0.1, 0.2), "Some shares.", low=0.0, high=1.0)

    def __post_init__(self) -> None:
        check_config(self)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("length", 0.09),
        ("length", 2.01),
        ("length", np.nan),
        ("length", np.inf),
        ("length", "0.5"),
        ("length", True),
        ("length", None),
        ("count", 0),
        ("count", 2.0),
        ("count", True),
        ("enabled", 1),
        ("enabled", "yes"),
        ("mode", "middle"),
        ("mode", 1),
        ("name", 7),
        ("levels", (0.5, 1.5)),
        ("levels", (0.5, "a")),
        ("levels", 0.5),
        ("levels", [0.5]),
    ],
)
def test_impossible_value_is_refused_by_name(name, value):
    with pytest.raises(ConfigError) as caught:
        replace(Example(), **{name: value})
    assert caught.value.parameter == name
    assert caught.value.value is value or caught.value.value in value
    assert isinstance(caught.value, (InfomapError, ValueError))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("length", 0.1),
        ("length", 2),
        ("length", np.float64(1.0)),
        ("count", 10**6),
        ("enabled", False),
        ("mode", "far"),
        ("name", "anything"),
        ("levels", ()),
        ("levels", (0.0, 1.0, 0.5)),
    ],
)
def test_possible_value_is_kept_as_given(name, value):
    assert getattr(replace(Example(), **{name: value}), name) is value


def test_error_says_what_would_be_accepted():
    with pytest.raises(ConfigError, match=r"'length' is 5.0.* at least 0.1 m and at most 2 m"):
        Example(length=5.0)
    with pytest.raises(ConfigError, match="one of near, far"):
        Example(mode="x")


def test_parameters_are_listed_in_order_with_default_and_description():
    listed = parameters_of(Example)
    assert list(listed) == ["length", "count", "enabled", "mode", "name", "levels"]
    default, info = listed["length"]
    assert default == 0.5
    assert (info.description, info.unit, info.low, info.high) == ("Some length.", "m", 0.1, 2.0)
    assert parameters_of(Example(length=1.0))["length"][0] == 0.5


@dataclass(frozen=True)
class Wheel:
    radius: float = parameter(0.1, "Radius.", unit="m", low=0.01, high=1.0)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class Cart:
    speed: float = parameter(1.0, "Speed.", unit="m/s", low=0.0)
    wheel: Wheel = field(default_factory=Wheel)


@dataclass(frozen=True)
class Train:
    name: str = parameter("", "Name.")
    cart: Cart = field(default_factory=Cart)


def test_parameters_of_nested_configurations_have_dotted_names() -> None:
    found = all_parameters(Train)
    assert list(found) == ["name", "cart.speed", "cart.wheel.radius"]
    assert found["cart.wheel.radius"][0] == 0.1


def test_nested_configuration_is_built_from_dotted_names() -> None:
    train = build_config(Train, {"cart.wheel.radius": 0.3, "name": "t"})
    assert train == Train("t", Cart(1.0, Wheel(0.3)))


@pytest.mark.parametrize(
    ("values", "name"),
    [({"cart.wheel.radius": 9.0}, "cart.wheel.radius"), ({"cart.wheels": 1}, "cart.wheels")],
)
def test_refused_nested_parameter_is_named_in_full(values: dict[str, float], name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        build_config(Train, values)
