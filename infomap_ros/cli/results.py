"""The folder for the results of a command, and what is said at its end.

Ctrl-C ends a command in order: what was done until then is kept.

The option ``--live``: a page that shows what a command does while it works.

What is shown on standard error while a command works.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from numba.core import event
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from infomap_ros.errors import InvalidInputError
from infomap_ros.viewer import LivePage

_RESULTS = ("summary.json", "exploration.jsonl", "map.infomap")


@contextmanager
def results_in(out: Path, overwrite: bool = False) -> Iterator[None]:
    """Make a folder for results, before any work, and keep other runs out of it meanwhile.

    Where the work fails before it has left anything, the folders that were made are removed again.

    Args:
        out: folder, made if it is not there.
        overwrite: replace the results of another run.

    Raises:
        InvalidInputError: the folder cannot be written, holds the results of another run, or
            another run is at work in it.
    """
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        out.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=out).close()
        handle = os.open(out, os.O_RDONLY)
    except OSError as error:
        raise InvalidInputError("--out", f"cannot write to {out}: {error.strerror}") from error
    try:
        _refuse_other_runs(out, handle, overwrite)
        yield
    finally:
        os.close(handle)
        with suppress(OSError):  # the first that is not empty
            for folder in made:
                folder.rmdir()


def check_free(out: Path, overwrite: bool) -> None:
    """Refuse to replace a file unasked.

    Raises:
        InvalidInputError: it is there.
    """
    if out.exists() and not overwrite:
        raise InvalidInputError("--out", f"{out} exists; give another file, or --overwrite")


def _refuse_other_runs(out: Path, handle: int, overwrite: bool) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InvalidInputError("--out", f"another run is at work in {out}") from None
    except OSError:  # a file system without locks
        pass
    found = [name for name in _RESULTS if (out / name).exists()]
    if found and not overwrite:
        raise InvalidInputError(
            "--out",
            f"{out} holds the results of another run ({found[0]}); give another folder, or "
            "--overwrite",
        )


def say_results(
    sentences: Sequence[str], summary: Mapping[str, object], out: Path, files: Mapping[str, str]
) -> None:
    """Say what came of a run: to a person on a terminal, else the summary as one line of JSON.

    Args:
        sentences: the run in a few lines.
        summary: its figures.
        out: folder of the results.
        files: what each of them is, the one to be opened first at the beginning; those that are
            not there are left out.
    """
    if not sys.stdout.isatty():
        typer.echo(json.dumps(summary))
        return
    there = {name: about for name, about in files.items() if (out / name).exists()}
    width = max((len(str(out / name)) for name in there), default=0)
    typer.echo("\n".join(sentences))
    for place, (name, about) in enumerate(there.items()):
        first = typer.style("  <- open this first", bold=True) if place == 0 else ""
        typer.echo(f"  {out / name!s:{width}}  {about}{first}")


def length(meters: float) -> str:
    """A length as a person says it."""
    if meters < 0.01:
        return f"{1e3 * meters:.1f} mm"
    return f"{1e2 * meters:.3g} cm" if meters < 1.0 else f"{meters:.2f} m"


INTERRUPTED = 130
"""Exit status of a command that was interrupted, as shells have it."""


@contextmanager
def stops_when_interrupted(
    stop: Callable[[], object], console: Console, kept: str
) -> Iterator[None]:
    """Let Ctrl-C stop the work in order; a second one ends the program.

    Args:
        stop: asks the work to end soon.
        console: where it is said.
        kept: what is written nevertheless.
    """

    def ask(number: int, frame: FrameType | None) -> None:
        del number, frame
        signal.signal(signal.SIGINT, before)
        stop()
        console.print(f"infomap: stopping; {kept} follow (Ctrl-C again: leave at once)")

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


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
