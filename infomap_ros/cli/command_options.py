"""Arguments and options that commands on bags share."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from infomap_ros.cli.settings import setting_names

Bag = Annotated[
    Path, typer.Argument(help="rosbag2 folder, .mcap, .db3, or ROS 1 .bag", show_default=False)
]
Out = Annotated[Path, typer.Option(help="folder for the results", show_default=False)]
Source = Annotated[Optional[str], typer.Option(help="auto, stereo or depth")]
Rectify = Annotated[Optional[str], typer.Option(help="auto, yes or no")]
_Topic = Annotated[str, typer.Option(show_default=False, metavar="TOPIC", rich_help_panel="Topics")]
Urdf = Annotated[str, typer.Option(help="URDF file, in place of the bag's", metavar="URDF")]
Setting = Annotated[
    Optional[list[str]],
    typer.Option("--set", metavar="SECTION.NAME=VALUE", help="any setting"),
]


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
        topics = [inspect.Parameter(n, keyword, default="", annotation=_Topic) for n in names]

        @wraps(command)
        def run(**given: Any) -> None:
            told = {name.removesuffix("_topic"): given.pop(name) for name in names}
            command(**given, topics=told)

        run.__annotations__ = {p.name: p.annotation for p in (*own, *topics)}
        run.__dict__["__signature__"] = inspect.Signature([*own, *topics])
        return run

    return give


def lists_settings(options: Callable[[], Any]) -> Callable[[bool], None]:
    """What ``--settings`` of a command does: print the names of all its settings, and end."""

    def list_settings(wanted: bool) -> None:
        if wanted:
            typer.echo("\n".join(setting_names(options())))
            raise typer.Exit

    return list_settings


def given_settings(shortcuts: Mapping[str, object], more: list[str] | None) -> list[str]:
    """The settings of a command line; those of ``--set`` come last, so that they count.

    Args:
        shortcuts: values of options that stand for a setting, by its name; None if not given.
        more: of ``--set``.
    """
    given = [f"{name}={value}" for name, value in shortcuts.items() if value is not None]
    return given + (more or [])
