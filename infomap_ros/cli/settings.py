"""Settings by name, as a user types them: ``map.voxel_size=0.02``."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import ParameterInfo, all_parameters

Options = TypeVar("Options")

_MOST_SUGGESTIONS = 3
_LIKE_ENOUGH = 0.6  # of the letters, as difflib counts them


def with_settings(
    options: Options, settings: Iterable[str], shortcuts: Mapping[str, str] | None = None
) -> Options:
    """Replace parameters inside the configurations of an options object, all of them together.

    Args:
        options: dataclass whose fields are configurations.
        settings: ``field.parameter=value`` each; elements of a tuple are separated by commas. Of
            two that name the same parameter the last one counts.
        shortcuts: option of the command line by the setting that it stands for, for errors.

    Returns:
        A copy.

    Raises:
        ConfigError: a setting has another form, names nothing that is there, or its value is
            refused; names the option.
    """
    known = all_settings(options)
    values: dict[str, Any] = {}
    try:
        for setting in settings:
            name, separator, text = (part.strip() for part in setting.partition("="))
            if not separator:
                raise ConfigError("--set", setting, "SECTION.NAME=VALUE")
            if name not in known:
                raise ConfigError("--set", name, _suggestion(name, known))
            default, info = known[name]
            values[name] = _parsed(name, text, default, info.element)
        return _replaced(options, values)
    except ConfigError as error:
        option = (shortcuts or {}).get(error.parameter)
        if option is None and error.parameter in known:
            option = f"--set {error.parameter}"
        raise ConfigError(option or error.parameter, error.value, error.expected) from error


def _suggestion(name: str, known: Iterable[str]) -> str:
    """What the user may have meant, by the whole name or by its last part."""
    names = list(known)
    near = difflib.get_close_matches(name, names, _MOST_SUGGESTIONS, _LIKE_ENOUGH)
    near += [one for one in names if one.rpartition(".")[2] == name.rpartition(".")[2]]
    near = list(dict.fromkeys(near))[:_MOST_SUGGESTIONS]
    meant = f"; did you mean {' or '.join(near)}?" if near else ""
    return f"the name of a setting (listed by --settings){meant}"


def _replaced(config: Any, values: Mapping[str, Any]) -> Any:
    """A copy of a configuration with parameters, by dotted name, set at once.

    Raises:
        ConfigError: a value is refused; names the parameter in full.
    """
    own = {name: value for name, value in values.items() if "." not in name}
    parts: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        part, dot, rest = name.partition(".")
        if dot:
            parts.setdefault(part, {})[rest] = value
    for part, inner in parts.items():
        try:
            own[part] = _replaced(getattr(config, part), inner)
        except ConfigError as error:
            raise ConfigError(f"{part}.{error.parameter}", error.value, error.expected) from error
    return dataclasses.replace(config, **own)


def all_settings(options: Any) -> dict[str, tuple[Any, ParameterInfo]]:
    """All settings of an options object: dotted name -> (default, info), in order."""
    return {
        f"{field.name}.{name}": entry
        for field in dataclasses.fields(options)
        if dataclasses.is_dataclass(getattr(options, field.name))
        for name, entry in all_parameters(getattr(options, field.name)).items()
    }


def settings_table(options: Any) -> str:
    """Each setting on a line: name, default, unit, what is accepted, and what it means."""
    lines = []
    for name, (default, info) in all_settings(options).items():
        accepted = info.accepted()
        facts = ", ".join(part for part in (info.unit, accepted) if part)
        value = ",".join(map(_typed, default)) if isinstance(default, tuple) else _typed(default)
        about = f"  [{facts}]" if facts else ""
        lines.append(f"{name}={value}{about}  {info.description}")
    return "\n".join(lines)


def _typed(value: Any) -> str:
    """A value as a user types it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _parsed(name: str, text: str, default: Any, element: Any = None) -> Any:
    if isinstance(default, tuple):
        return tuple(_parsed(name, part.strip(), element) for part in text.split(",") if text)
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
