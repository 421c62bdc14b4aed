"""What the commands of the studies have in common."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

from infomap_ros.errors import ConfigError, InfomapError
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.views.ranking.strategies import make_strategy

Out = Annotated[Path, typer.Option(help="folder for the results", show_default=False)]
Quick = Annotated[bool, typer.Option("--quick", help="a small study, in less than a minute")]
Jobs = Annotated[int, typer.Option(help="processes; 0 for one per core", min=0)]
Strategies = Annotated[
    str,
    typer.Option(help="names or dotted paths of classes, with commas; the study's own if empty"),
]
DrawOnly = Annotated[bool, typer.Option("--draw-only", help="compute nothing, use what is there")]


def workers(jobs: int) -> int:
    """Number of processes: as asked for, or one per core."""
    return jobs or os.cpu_count() or 1


def chosen_strategies(names: str, usual: tuple[str, ...]) -> tuple[str, ...]:
    """What the option `Strategies` asks for; classes may be in files of the current folder.

    Args:
        names: with commas between them.
        usual: taken where there are none.

    Raises:
        ConfigError: there is no such strategy.
    """
    found = tuple(name.strip() for name in names.split(",")) if names else usual
    for name in found:
        check_strategy(name, "--strategies")
    return found


def check_strategy(name: str, option: str = "--strategy") -> None:
    """Refuse what is no strategy, by the option; a class may be in a file of the current folder.

    Raises:
        ConfigError: there is no such strategy.
    """
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        make_strategy(name)
    except ConfigError as error:
        raise ConfigError(option, error.value, error.expected) from error


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
    """A bar on stderr, lines where that is a file; gives a function that is told what is done."""
    columns = (*Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda done: typer.echo(f"{name}: {done} of {total}", err=True)
        return
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(name, total=total)
        yield lambda done: bar.update(task, completed=done)


def finish(name: str, tables: str, figures: Mapping[str, float | str], out: Path) -> None:
    """Write the tables, as NAME.md, and summary.json; print both."""
    write_text(out / f"{name}.md", tables)
    text = json.dumps(dict(figures))
    write_text(out / "summary.json", text + "\n")
    typer.echo(tables)
    typer.echo(text)
