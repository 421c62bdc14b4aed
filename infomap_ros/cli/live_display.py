"""The option ``--live``: a page that shows what a command does while it works."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from infomap_ros.viewer import LivePage

Live = Annotated[
    bool,
    typer.Option(
        "--live", help="show the run in a browser while it goes on; the page stays until Ctrl-C"
    ),
]


@contextmanager
def live_page(wanted: bool, title: str, *, has_plans: bool = False) -> Iterator[LivePage | None]:
    """A page while a command works, and after it until the user has seen enough.

    Args:
        wanted: whether there is to be one.
        title: of the page.
        has_plans: whether views are chosen in this run.

    Raises:
        MissingExtraError: viser is not installed.
    """
    if not wanted:
        yield None
        return
    page = LivePage(title, has_plans=has_plans)
    typer.echo(f"infomap: watch it in a browser: {page.address}", err=True)
    try:
        yield page
        typer.echo("infomap: the page stays until Ctrl-C", err=True)
        _wait()
    finally:
        page.close()


def _wait() -> None:
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        return
