"""The progress of an exploration on the console."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.status import Status


class RunProgress:
    """One line that says how far the exploration is, and a line for each choice.

    Args:
        console: where to.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status = Status("preparing world and kernels", console=console)

    def __enter__(self) -> RunProgress:
        self._status.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._status.stop()

    def show(self, entry: Mapping[str, Any]) -> None:
        """Show an entry of the run log."""
        kind = entry["kind"]
        if kind == "progress":
            self._status.update(progress_line(entry))
        elif kind == "decision":
            self._console.print(f"{entry['t']:7.1f} s  {entry['reason']}", highlight=False)
        elif kind == "motion" and entry["outcome"]:
            text = f"{entry['action']}: {entry['outcome']}"
            self._console.print(f"{entry['t']:7.1f} s  {text}", highlight=False)
        elif kind == "end":
            text = f"ended: {entry['reason']}: {entry['detail']}"
            self._console.print(f"{entry['t']:7.1f} s  {text}", highlight=False)


def progress_line(entry: Mapping[str, Any]) -> str:
    """A progress entry in words."""
    sigma = entry["mean_sigma"]
    precision = "" if sigma is None else f", mean sigma {1e3 * sigma:.1f} mm"
    return (
        f"{entry['views']} views, {entry['distance']:.1f} m, "
        f"{100.0 * entry['known_fraction']:.1f} % known, "
        f"{100.0 * entry['precise_fraction']:.1f} % precisely, "
        f"{entry['entropy_bits']:,.0f} bits left{precision}"
    )
