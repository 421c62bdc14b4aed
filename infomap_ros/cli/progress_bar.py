"""What is shown on standard error while a command works."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer
from numba.core import event
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from infomap_ros.cli.interrupts import stops_when_interrupted

_LEAST_COMPILED = 3.0  # what takes less is not worth a line [s]


def run_with_bar(
    run: Callable[[Callable[[int, int], None]], None],
    stop: Callable[[], None],
    doing: str,
    what: str,
    total: int,
) -> None:
    """Run something that tells how many of how many are done; Ctrl-C ends it in order.

    Args:
        run: gets what is to be told.
        stop: lets it end early.
        doing: before the bar.
        what: behind the numbers.
        total: number at the end.
    """
    columns = (doing, BarColumn(), MofNCompleteColumn(), what, TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=total)
        interrupts = stops_when_interrupted(stop, progress.console, "the results so far")
        with says_when_it_compiles(progress.console), interrupts:
            run(lambda done, of: progress.update(task, completed=done, total=of))


@contextmanager
def says_when_it_compiles(console: Console | None = None) -> Iterator[None]:
    """Say so where kernels are compiled, and how long that took: a first run waits for it.

    Args:
        console: where to; standard error where not given.
    """
    listener = _CompilationListener(console.print if console else _to_stderr)
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)
        if listener.seconds > _LEAST_COMPILED:
            listener.say(f"infomap: compiled in {listener.seconds:.0f} s, kept for later runs")


def _to_stderr(text: str) -> None:
    typer.echo(text, err=True)


class _CompilationListener(event.Listener):  # type: ignore[misc]
    """Listens to numba's events; what one kernel needs is compiled within its own event."""

    def __init__(self, say: Callable[[str], object]) -> None:
        self.say, self.seconds = say, 0.0
        self._depth, self._start, self._has_said = threading.local(), 0.0, False

    def on_start(self, event: event.Event) -> None:
        """A compilation begins."""
        depth = getattr(self._depth, "value", 0)
        self._depth.value = depth + 1
        if depth == 0:
            self._start = time.monotonic()
        if not self._has_said:
            self._has_said = True
            self.say("infomap: compiling for this machine, once; it takes about a minute")

    def on_end(self, event: event.Event) -> None:
        """A compilation ends."""
        self._depth.value = getattr(self._depth, "value", 1) - 1
        if self._depth.value == 0:
            self.seconds += time.monotonic() - self._start
