"""Declare ROS parameters from configuration dataclasses.

Description, unit, range and default come from the configuration class alone. Parameters are
read-only, but for those that a node names as settable: a new value is judged by the configuration
class that judges the first one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import ParameterInfo, all_parameters, build_config

Config = TypeVar("Config")

_LARGEST_INTEGER = 2**63 - 1
_LARGEST_NUMBER = 1.7976931348623157e308


def declare_config(
    node: Node, config_class: type[Config], prefix: str = "", settable: Sequence[str] = ()
) -> Config:
    """Declare the public fields of a configuration as parameters and read all of them.

    Args:
        node: the node; parameter overrides given to it apply.
        config_class: a configuration whose fields are made by `geometry.config.parameter`, or are
            configurations themselves, whose parameters have the field's name before theirs.
        prefix: put before each parameter's name, for example ``poses.``.
        settable: file-name patterns of parameters that may be set while the node runs.

    Returns:
        The validated configuration.

    Raises:
        ConfigError: a value has the wrong type or is out of range; it names the parameter.
    """
    fields = all_parameters(config_class)
    values = {name: _given(node, prefix + name, *field) for name, field in fields.items()}
    config = _build(config_class, prefix, values)
    for name, (default, info) in fields.items():
        if not info.public:
            continue
        value = list(values[name]) if isinstance(default, tuple) else values[name]
        descriptor = describe(default, info)
        descriptor.read_only = not is_settable(prefix + name, settable)
        node.declare_parameter(prefix + name, value, descriptor, ignore_override=True)
    return config


def is_settable(name: str, settable: Sequence[str]) -> bool:
    """Whether a parameter of that full name matches one of the patterns."""
    return any(fnmatchcase(name, pattern) for pattern in settable)


def changed_config(config: Config, prefix: str, values: Mapping[str, Any]) -> Config:
    """The configuration with other values; the same object where none of them is its own.

    Args:
        config: as it is.
        prefix: of its parameters' names.
        values: by full name, those of other configurations among them.

    Raises:
        ConfigError: a value is refused; names the parameter in full.
    """
    fields = all_parameters(type(config))
    own = {name: values[prefix + name] for name in fields if prefix + name in values}
    if not own:
        return config
    everything = {**parameter_values(config), **own}
    kept = {name: _of_kind(*fields[name], value) for name, value in everything.items()}
    return _build(type(config), prefix, kept)


def parameter_values(config: object, prefix: str = "") -> dict[str, Any]:
    """The values of a configuration object by the names of its parameters, as nodes declare them.

    Args:
        config: its fields are made by `geometry.config.parameter`, or are configurations.
        prefix: put before each parameter's name.
    """
    values: dict[str, Any] = {}
    for field in dataclasses.fields(config):  # type: ignore[arg-type]
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            values |= parameter_values(value, f"{prefix}{field.name}.")
        else:
            values[prefix + field.name] = list(value) if isinstance(value, tuple) else value
    return values


def describe(default: Any, info: ParameterInfo) -> ParameterDescriptor:
    """Descriptor of a read-only parameter: description with unit, choices, range."""
    unit = f" [{info.unit}]" if info.unit else ""
    descriptor = ParameterDescriptor(description=info.description + unit, read_only=True)
    if info.choices:
        descriptor.additional_constraints = info.expectation()
    if info.low is None and info.high is None:
        return descriptor
    sample = info.element if isinstance(default, tuple) else default
    if isinstance(sample, int):
        descriptor.integer_range = [
            IntegerRange(
                from_value=-_LARGEST_INTEGER if info.low is None else math.ceil(info.low),
                to_value=_LARGEST_INTEGER if info.high is None else math.floor(info.high),
            )
        ]
    else:
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=-_LARGEST_NUMBER if info.low is None else float(info.low),
                to_value=_LARGEST_NUMBER if info.high is None else float(info.high),
            )
        ]
    return descriptor


def _given(node: Node, name: str, default: Any, info: ParameterInfo) -> Any:
    """What the user gave for a parameter, else its default; whole numbers fit where reals do."""
    value = list(default) if isinstance(default, tuple) else default
    peek = ParameterDescriptor(dynamic_typing=True)
    given = node.declare_parameter(name, value, peek).value
    node.undeclare_parameter(name)
    if given is None:  # an empty list in a parameter file has no type
        return default
    return _of_kind(default, info, given)


def _build(config_class: type[Config], prefix: str, values: Mapping[str, Any]) -> Config:
    try:
        return build_config(config_class, values)
    except ConfigError as error:
        raise ConfigError(prefix + error.parameter, error.value, error.expected) from error


def _of_kind(default: Any, info: ParameterInfo, given: Any) -> Any:
    """A value as its configuration holds it."""
    if isinstance(default, tuple):
        elements = given if isinstance(given, Iterable) and not isinstance(given, str) else (given,)
        return tuple(_as_kind_of(info.element, each) for each in elements)
    return _as_kind_of(default, given)


def _as_kind_of(default: Any, value: Any) -> Any:
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value
