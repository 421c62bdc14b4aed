"""What the commands of the studies have in common."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

from infomap_ros.errors import InfomapError

Out = Annotated[Path, typer.Option(help="folder for the results", show_default=False)]
Quick = Annotated[bool, typer.Option("--quick", help="a small study, in less than a minute")]
Jobs = Annotated[int, typer.Option(help="processes; 0 for one per core")]
Strategies = Annotated[
    str,
    typer.Option(help="names or dotted paths of classes, with commas; the study's own if empty"),
]
DrawOnly = Annotated[bool, typer.Option("--draw-only", help="compute nothing, use what is there")]


def workers(jobs: int) -> int:
    """Number of processes: as asked for, or one per core."""
    return jobs or os.cpu_count() or 1


@contextmanager
def refusals() -> Iterator[None]:
    """One clear line instead of a traceback for what the library refuses."""
    try:
        yield
    except InfomapError as error:
        typer.echo(f"infomap study: {error}", err=True)
        raise typer.Exit(1) from error


@contextmanager
def progress_bar(name: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on stderr; gives a function that is told how many are done."""
    columns = (*Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=total)
        yield lambda done: bar.update(task, completed=done)


def finish(name: str, tables: str, figures: Mapping[str, float | str], out: Path) -> None:
    """Write the tables, as NAME.md, and summary.json; print both."""
    (out / f"{name}.md").write_text(tables, encoding="utf-8")
    text = json.dumps(dict(figures))
    (out / "summary.json").write_text(text + "\n", encoding="utf-8")
    typer.echo(tables)
    typer.echo(text)
