"""Arguments and options that commands on bags share.

Settings by name, as a user types them: ``map.voxel_size=0.02``.
"""

from __future__ import annotations

import dataclasses
import difflib
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Optional, TypeVar

import typer

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
    """All settings of an options object: dotted name -> (default, info), its own first."""
    own = type(options).__annotations__
    return {
        f"{field.name}.{name}": entry
        for field in sorted(dataclasses.fields(options), key=lambda field: field.name not in own)
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


Bag = Annotated[
    Path,
    typer.Argument(
        help="rosbag2 folder, .mcap, .db3, ROS 1 .bag, or a folder of images", show_default=False
    ),
]
_BAGS_HELP = "rosbag2 folders, .mcap, .db3, ROS 1 .bag, or folders of images, in one frame"
Bags = Annotated[list[Path], typer.Argument(help=_BAGS_HELP, show_default=False)]
Out = Annotated[Path, typer.Option(help="folder for the results", show_default=False)]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="replace the results of another run")]
Source = Annotated[str, typer.Option(help="auto, stereo or depth")]
Rectify = Annotated[str, typer.Option(help="whether images are raw: auto, yes or no")]
Calibration = Annotated[
    Optional[list[Path]],
    typer.Option(
        help="of a folder of images: Kalibr, ROS, OpenCV, KITTI or Middlebury; one file, or the "
        "left and the right camera's"
    ),
]
Urdf = Annotated[str, typer.Option(help="URDF file, in place of the bag's", metavar="URDF")]
Setting = Annotated[
    Optional[list[str]],
    typer.Option("--set", metavar="SECTION.NAME=VALUE", help="override a setting; may be repeated"),
]
_TOPICS = {
    "left_image": "left images",
    "right_image": "right images",
    "left_info": "camera info of the left images",
    "right_info": "camera info of the right images",
    "depth": "depth images",
    "info": "camera info of the depth images",
    "color": "color images of the same pixels as the depth images",
    "pose_topic": "poses, odometry or tf",
    "odometry": "odometry",
    "imu": "an inertial sensor on the camera",
    "joints": "joint states",
}


IMAGE_TOPICS = ("left_image", "right_image", "left_info", "right_info", "depth", "info")
"""Topics of every command that takes images from a bag."""


def takes_topics(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command one more option for each topic, which is empty where it is not given.

    The command gets them by its parameter ``topics``, the topic by its name; an option that has to
    be called ``pose_topic``, because ``pose`` might mean something else, is the topic ``pose``.

    Args:
        names: of the options.
    """

    def give(command: Callable[..., None]) -> Callable[..., None]:
        keyword = inspect.Parameter.KEYWORD_ONLY
        own = [
            p.replace(kind=keyword)
            for p in inspect.signature(command).parameters.values()
            if p.name != "topics"
        ]
        topics = [inspect.Parameter(n, keyword, default="", annotation=_topic(n)) for n in names]

        @wraps(command)
        def run(**given: Any) -> None:
            topics = {name.removesuffix("_topic"): given.pop(name) for name in names}
            command(**given, topics=topics)

        run.__annotations__ = {p.name: p.annotation for p in (*own, *topics)}
        run.__dict__["__signature__"] = inspect.Signature([*own, *topics])
        return run

    return give


def _topic(name: str) -> Any:
    """The option of a topic."""
    return Annotated[
        str,
        typer.Option(
            help=_TOPICS[name], show_default=False, metavar="TOPIC", rich_help_panel="Topics"
        ),
    ]


def lists_settings(options: Callable[[], Any]) -> Any:
    """The option ``--settings`` of a command: print all its settings, and end."""

    def list_settings(wanted: bool) -> None:
        if wanted:
            typer.echo(settings_table(options()))
            raise typer.Exit

    about = "list all settings with default, unit, range and meaning"
    return typer.Option("--settings", callback=list_settings, is_eager=True, help=about)


def chosen(
    options: Options,
    shortcuts: Mapping[str, tuple[str, object]],
    more: list[str] | None,
    before: Sequence[str] = (),
) -> Options:
    """The options as a command line asks for; those of ``--set`` come last, so that they count.

    Args:
        options: with their defaults.
        shortcuts: setting and value by the option that stands for it; None if not given.
        more: of ``--set``.
        before: settings that count for least, ``name=value`` each.

    Raises:
        ConfigError: a value is refused; names the option.
    """
    given = {o: (name, value) for o, (name, value) in shortcuts.items() if value is not None}
    settings = [f"{name}={value}" for name, value in given.values()]
    names = {name: option for option, (name, _) in given.items()}
    later = {setting.partition("=")[0].strip() for setting in more or []}
    shown = {name: option for name, option in names.items() if name not in later}
    return with_settings(options, [*before, *settings, *(more or [])], shown)
