"""What the demos' command lines have in common: progress, results, and how they end."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from rich.console import Console

from infomap_ros.errors import InfomapError


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def say_page(address: str, console: Console) -> None:
    """Say where the run can be watched; nothing where there is no page."""
    if address:
        console.print(f"watch it in a browser: {address}", highlight=False, soft_wrap=True)


def run_demo_command(name: str, out: Path, run: Callable[[Console], Mapping[str, object]]) -> int:
    """Run a demo and print its figures as one line of JSON; progress goes to stderr.

    Args:
        name: of the command, for messages.
        out: where it leaves its results.
        run: the demo; given a console for its progress, returns its figures.

    Returns:
        Exit status: 1 with one line where it could not be done, 130 when it was interrupted.
    """
    console = Console(stderr=True)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        figures = run(console)
    except (InfomapError, OSError) as error:
        print(f"infomap {name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"infomap {name}: interrupted", file=sys.stderr)
        return 130
    console.print(f"map, report.html and all else are in {out}")
    print(json.dumps(figures))
    return 0
