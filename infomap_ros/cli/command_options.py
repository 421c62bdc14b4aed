"""Arguments and options that commands on bags share."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Optional, TypeVar

import typer

from infomap_ros.cli.settings import settings_table, with_settings

Options = TypeVar("Options")

Bag = Annotated[
    Path,
    typer.Argument(
        help="rosbag2 folder, .mcap, .db3, ROS 1 .bag, or a folder of images", show_default=False
    ),
]
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
            told = {name.removesuffix("_topic"): given.pop(name) for name in names}
            command(**given, topics=told)

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
