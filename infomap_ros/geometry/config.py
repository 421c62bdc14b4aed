"""Configuration fields that carry their own description, unit and range.

A configuration is a frozen dataclass whose fields are made by `parameter`. The same metadata
validate the object, describe a ROS parameter, and fill the parameter tables of the docs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from infomap_ros.errors import ConfigError

_METADATA_KEY = "parameter"


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of one configuration field.

    Attributes:
        description: one or two sentences.
        unit: SI unit or empty.
        low: smallest allowed number, inclusive, or None.
        high: largest allowed number, inclusive, or None.
        choices: allowed strings, empty for any.
    """

    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()

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
) -> Any:
    """Declare a dataclass field with its default, description, unit and range.

    Args:
        default: bool, int, float, str, or tuple of one of these.
        description: one or two sentences for the user.
        unit: SI unit or empty.
        low: smallest allowed number, inclusive.
        high: largest allowed number, inclusive.
        choices: allowed strings.
    """
    info = ParameterInfo(description, unit, low, high, choices)
    return dataclasses.field(default=default, metadata={_METADATA_KEY: info})


def parameters_of(config: Any) -> Mapping[str, tuple[Any, ParameterInfo]]:
    """Fields of a configuration class or object: name -> (default, info), in order."""
    return {
        field.name: (field.default, field.metadata[_METADATA_KEY])
        for field in dataclasses.fields(config)
        if _METADATA_KEY in field.metadata
    }


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
                _check_value(name, element, default[0] if default else element, info)
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
