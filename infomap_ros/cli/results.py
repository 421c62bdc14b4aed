"""The folder for the results of a command, and what is said at its end."""

from __future__ import annotations

import fcntl
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import typer

from infomap_ros.errors import InvalidInputError

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
