"""The runs of a study: many, over the cores, each kept in a file as soon as it is done.

Tables of a study as CSV.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import os
import signal
import threading
from collections.abc import Callable, Hashable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.atomic_file import replacing, write_text

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)


class Task(Protocol[Result_co]):
    """One run of a study; hashable, and can be pickled.

    Attributes:
        file_name: where the result is kept, with the suffix .npz.
    """

    @property
    def file_name(self) -> str: ...  # noqa: D102

    def fingerprint(self) -> str:
        """All that the result depends on, but for the code; a result with another one is stale."""

    def run(self) -> Result_co:
        """Do it; returns a dataclass object of arrays, numbers and texts."""


Work = TypeVar("Work", bound=Task[Any])


@dataclasses.dataclass(frozen=True)
class Kept(Generic[Result]):
    """The folder that keeps the results of one kind.

    Attributes:
        folder: made if need be; one file for each result.
        kind: class of the results.
    """

    folder: Path
    kind: type[Result]

    def load(self, task: Task[Result]) -> Result | None:
        """The kept result of a task; None where there is none, or a stale one."""
        path = self.folder / task.file_name
        if not path.exists():
            return None
        with np.load(path) as kept:
            if str(kept["fingerprint"]) != task.fingerprint():
                return None
            values = {name: kept[name] for name in kept.files if name != "fingerprint"}
        if set(values) != {field.name for field in dataclasses.fields(self.kind)}:  # type: ignore[arg-type]
            return None
        return self.kind(**{n: v if v.ndim else v.item() for n, v in values.items()})

    def save(self, task: Task[Result], result: Result) -> None:
        """Keep a result: the file is there as a whole or not at all."""
        fields = dataclasses.fields(result)  # type: ignore[arg-type]
        arrays: dict[str, Any] = {field.name: getattr(result, field.name) for field in fields}
        path = self.folder / task.file_name
        with replacing(path) as file:
            np.savez_compressed(file, fingerprint=task.fingerprint(), **arrays)


def run_all(
    tasks: Sequence[Work],
    kept: Kept[Result],
    jobs: int,
    progress: Callable[[int], None] | None = None,
    compute: bool = True,
) -> dict[Work, Result]:
    """Do what is not done yet; what is found in the folder is not done again.

    Args:
        tasks: what to do; the first are done first.
        kept: keeps the results.
        jobs: processes.
        progress: called with the number of tasks done.
        compute: else only what is found is returned.

    Returns:
        Results by task, in the order of the tasks.

    Raises:
        InvalidInputError: nothing is to be computed, and nothing is found.
    """
    kept.folder.mkdir(parents=True, exist_ok=True)
    found = {task: kept.load(task) for task in tasks}
    done = sum(result is not None for result in found.values())
    if not done and not compute:
        raise InvalidInputError("--draw-only", f"{kept.folder} holds no run of this study")
    if progress is not None:
        progress(done)
    missing = [task for task, result in found.items() if result is None] if compute else []
    if missing:
        spawned = get_context("spawn")
        with ProcessPoolExecutor(jobs, mp_context=spawned, initializer=_end_on_signal) as pool:
            futures = {pool.submit(_run_and_keep, task, kept): task for task in missing}
            try:
                for future in as_completed(futures):
                    found[futures[future]] = future.result()
                    done += 1
                    if progress is not None:
                        progress(done)
            except BaseException:  # interrupted, or a run failed: no other is begun
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return {task: result for task, result in found.items() if result is not None}


Run = TypeVar("Run")


def in_all_worlds(
    runs: Sequence[Run], world: Callable[[Run], Hashable], label: Callable[[Run], str]
) -> list[Run]:
    """The runs in worlds that have one of every label, for paired tables.

    Args:
        runs: of a study that may be unfinished.
        world: of a run.
        label: what is compared, a strategy for instance.
    """
    labels = {label(run) for run in runs}
    found: dict[Hashable, set[str]] = {}
    for run in runs:
        found.setdefault(world(run), set()).add(label(run))
    return [run for run in runs if found[world(run)] == labels]


def _end_on_signal() -> None:
    """Let a worker end at once with Ctrl-C, and when its parent is gone.

    Without it, a worker takes the interrupt for the failure of one run, and goes on to the next.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


def _run_and_keep(task: Task[Result], kept: Kept[Result]) -> Result:
    result = task.run()
    kept.save(task, result)
    return result


def write_rows(rows: Sequence[object], path: Path) -> None:
    """Write dataclass objects of one class, one per line."""
    names = [field.name for field in dataclasses.fields(rows[0])] if rows else []  # type: ignore[arg-type]
    write_lines(names, ([getattr(row, name) for name in names] for row in rows), path)


def write_lines(names: Sequence[str], lines: Iterable[Sequence[object]], path: Path) -> None:
    """Write a header and lines; floats with five digits."""
    table = io.StringIO(newline="")
    writer = csv.writer(table)
    writer.writerow(names)
    writer.writerows([_text(value) for value in line] for line in lines)
    write_text(path, table.getvalue())


def _text(value: object) -> object:
    return f"{value:.5g}" if isinstance(value, float) else value


def markdown(names: Sequence[str], lines: Iterable[Sequence[object]]) -> str:
    """A Markdown table."""
    rows = [names, ["---"] * len(names), *lines]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in rows) + "\n"
