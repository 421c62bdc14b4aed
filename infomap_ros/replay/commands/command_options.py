"""Arguments and options that commands on bags share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

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
