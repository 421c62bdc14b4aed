"""A bar on standard error while a bag is worked through."""

from __future__ import annotations

from collections.abc import Callable

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn


def run_with_bar(
    run: Callable[[Callable[[int, int], None]], None], doing: str, what: str, total: int
) -> None:
    """Run something that tells how many of how many are done.

    Args:
        run: gets what is to be told.
        doing: before the bar.
        what: behind the numbers.
        total: number at the end.
    """
    columns = (doing, BarColumn(), MofNCompleteColumn(), what, TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=total)
        run(lambda done, of: progress.update(task, completed=done, total=of))
