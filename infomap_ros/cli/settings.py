"""Settings by name, as a user types them: ``map.voxel_size=0.02``."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, TypeVar

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import all_parameters

Options = TypeVar("Options")


def with_settings(options: Options, settings: Iterable[str]) -> Options:
    """Replace parameters inside the configurations of an options object.

    Args:
        options: dataclass whose fields are configurations.
        settings: ``field.parameter=value`` each; elements of a tuple are separated by commas.

    Returns:
        A copy.

    Raises:
        ConfigError: a setting has another form, names nothing that is there, or its value is
            refused.
    """
    for setting in settings:
        name, separator, text = setting.partition("=")
        section, dot, parameter = name.strip().partition(".")
        if not separator or not dot:
            raise ConfigError("setting", setting, "section.parameter=value")
        config = getattr(options, section, None)
        known = all_parameters(config) if dataclasses.is_dataclass(config) else {}
        if parameter not in known:
            raise ConfigError("setting", name, f"one of {', '.join(setting_names(options))}")
        value = _parsed(parameter, text.strip(), known[parameter][0])
        changed = _replaced(config, parameter.split("."), value)
        options = dataclasses.replace(options, **{section: changed})  # type: ignore[type-var]
    return options


def _replaced(config: Any, path: list[str], value: Any) -> Any:
    """A copy of a configuration with the parameter at a path set."""
    name, *rest = path
    if rest:
        value = _replaced(getattr(config, name), rest, value)
    return dataclasses.replace(config, **{name: value})


def setting_names(options: Any) -> list[str]:
    """Names of all settings of an options object."""
    return [
        f"{field.name}.{name}"
        for field in dataclasses.fields(options)
        if dataclasses.is_dataclass(getattr(options, field.name))
        for name in all_parameters(getattr(options, field.name))
    ]


def _parsed(name: str, text: str, default: Any) -> Any:
    if isinstance(default, tuple):
        sample = default[0] if default else ""
        return tuple(_parsed(name, part.strip(), sample) for part in text.split(","))
    if isinstance(default, bool):
        if text.lower() not in ("true", "false"):
            raise ConfigError(name, text, "true or false")
        return text.lower() == "true"
    if isinstance(default, str):
        return text
    kind = type(default)
    try:
        return kind(text)
    except ValueError:
        expected = "a whole number" if kind is int else "a number"
        raise ConfigError(name, text, expected) from None
