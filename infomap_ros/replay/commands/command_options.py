"""Arguments and options that commands on bags share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from infomap_ros.replay.commands.settings import setting_names

Bag = Annotated[
    Path, typer.Argument(help="rosbag2 folder, .mcap, .db3, or ROS 1 .bag", show_default=False)
]
Out = Annotated[Path, typer.Option(help="folder for the results", show_default=False)]
Source = Annotated[Optional[str], typer.Option(help="auto, stereo or depth")]
Rectify = Annotated[Optional[str], typer.Option(help="auto, yes or no")]
Topic = Annotated[str, typer.Option(show_default=False, metavar="TOPIC", rich_help_panel="Topics")]
Urdf = Annotated[str, typer.Option(help="URDF file, in place of the bag's", metavar="URDF")]
Setting = Annotated[
    Optional[list[str]],
    typer.Option("--set", metavar="SECTION.NAME=VALUE", help="any setting"),
]


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
