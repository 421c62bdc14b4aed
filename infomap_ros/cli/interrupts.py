"""Ctrl-C ends a command in order: what was done until then is kept."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from rich.console import Console

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
