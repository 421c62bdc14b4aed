"""Configuration fields that carry their own description, unit and range.

A configuration is a frozen dataclass whose fields are made by `parameter`. The same metadata
validate the object, describe a ROS parameter, and fill the parameter tables of the docs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from infomap_ros.errors import ConfigError

Config = TypeVar("Config")

_METADATA_KEY = "parameter"
_SAMPLES: dict[str, bool | int | float | str] = {"bool": False, "int": 0, "float": 0.0, "str": ""}


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of one configuration field.

    Attributes:
        description: one or two sentences.
        unit: SI unit or empty.
        low: smallest allowed number, inclusive, or None.
        high: largest allowed number, inclusive, or None.
        choices: allowed strings, empty for any.
        public: a ROS parameter of the nodes; else a setting of the library alone.
        element: of a tuple, a value of the kind that its elements have.
    """

    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    public: bool = True
    element: bool | int | float | str = ""

    def accepted(self) -> str:
        """The choices or the range, briefly; empty where everything is accepted."""
        if self.choices:
            return "|".join(self.choices)
        low, high = (None if end is None else f"{end:g}" for end in (self.low, self.high))
        if low is None or high is None:
            return f"at least {low}" if low else f"at most {high}" if high else ""
        return f"{low} to {high}"

    def expectation(self) -> str:
        """What values are accepted, in words."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        unit = f" {self.unit}" if self.unit else ""
        low = "" if self.low is None else f" at least {self.low:g}{unit}"
        high = "" if self.high is None else f" at most {self.high:g}{unit}"
        return "a finite number" + (" and".join(part for part in (low, high) if part))


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    public: bool = True,
) -> Any:
    """Declare a dataclass field with its default, description, unit and range.

    Args:
        default: bool, int, float, str, or tuple of one of these.
        description: one or two sentences for the user.
        unit: SI unit or empty.
        low: smallest allowed number, inclusive.
        high: largest allowed number, inclusive.
        choices: allowed strings.
        public: a ROS parameter of the nodes; else see `setting`.
    """
    info = ParameterInfo(description, unit, low, high, choices, public)
    return dataclasses.field(default=default, metadata={_METADATA_KEY: info})


setting = partial(parameter, public=False)
"""Declares a field as `parameter` does that is no ROS parameter of a node.

It is for what studies, the simulator and tests vary. It is validated in the same way. A node takes
a value that it is started with, and does not declare it; it stands in no parameter file and in no
table.
"""


def parameters_of(config: Any) -> Mapping[str, tuple[Any, ParameterInfo]]:
    """Fields of a configuration class or object: name -> (default, info), in order."""
    return {
        field.name: (field.default, _info_of(field))
        for field in dataclasses.fields(config)
        if _METADATA_KEY in field.metadata
    }


def _info_of(field: dataclasses.Field[Any]) -> ParameterInfo:
    info: ParameterInfo = field.metadata[_METADATA_KEY]
    if not isinstance(field.default, tuple):
        return info
    kind = str(field.type).removeprefix("tuple[").partition(",")[0]
    return dataclasses.replace(info, element=_SAMPLES[kind])


def nested_configs(config: Any) -> Mapping[str, Any]:
    """Fields of a configuration class or object that are configurations: name -> their default."""
    factories: dict[str, Any] = {
        field.name: field.default_factory for field in dataclasses.fields(config)
    }
    return {
        name: make()
        for name, make in factories.items()
        if isinstance(make, type) and dataclasses.is_dataclass(make)
    }


def all_parameters(config: Any) -> dict[str, tuple[Any, ParameterInfo]]:
    """Fields of a configuration and of those in it: dotted name -> (default, info), in order."""
    found = dict(parameters_of(config))
    for name, part in nested_configs(config).items():
        found |= {f"{name}.{inner}": entry for inner, entry in all_parameters(part).items()}
    return found


def build_config(config_class: type[Config], values: Mapping[str, Any]) -> Config:
    """Make a configuration, those in it included.

    Args:
        config_class: the class.
        values: by dotted name as in `all_parameters`; what is missing has its default.

    Raises:
        ConfigError: a value is refused, or nothing has that name; names it in full.
    """
    unknown = set(values) - set(all_parameters(config_class))
    if unknown:
        raise ConfigError(min(unknown), values[min(unknown)], "the name of a parameter")
    own = {name: values[name] for name in parameters_of(config_class) if name in values}
    for name, part in nested_configs(config_class).items():
        inner = {
            dotted.removeprefix(f"{name}."): value
            for dotted, value in values.items()
            if dotted.startswith(f"{name}.")
        }
        try:
            own[name] = build_config(type(part), inner)
        except ConfigError as error:
            raise ConfigError(f"{name}.{error.parameter}", error.value, error.expected) from error
    return config_class(**own)


def check_config(config: Any) -> None:
    """Validate all fields of a configuration; call it from ``__post_init__``.

    Raises:
        ConfigError: a field has the wrong type, is out of range or not among its choices. The
            error names the field, its value and what is expected.
    """
    for name, (default, info) in parameters_of(config).items():
        value = getattr(config, name)
        if isinstance(default, tuple):
            if not isinstance(value, tuple):
                raise ConfigError(name, value, "a tuple")
            for element in value:
                _check_value(name, element, info.element, info)
        else:
            _check_value(name, value, default, info)


def _check_value(name: str, value: object, default: object, info: ParameterInfo) -> None:
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ConfigError(name, value, "true or false")
    elif isinstance(default, str):
        if not isinstance(value, str) or (info.choices and value not in info.choices):
            raise ConfigError(name, value, info.expectation() if info.choices else "a string")
    else:
        _check_number(name, value, default, info)


def _check_number(name: str, value: object, default: object, info: ParameterInfo) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(name, value, info.expectation())
    if isinstance(default, int) and not isinstance(value, int):
        raise ConfigError(name, value, "a whole number")
    below = info.low is not None and value < info.low
    above = info.high is not None and value > info.high
    if not math.isfinite(value) or below or above:
        raise ConfigError(name, value, info.expectation())
