"""The log of a run: one JSON object per line, readable while the run goes on.

Every line has ``t``, seconds since the start, ``kind``, and ``clock``, what the robot takes for the
time [s]:

- ``start``: task, robot, world, strategy, voxel_size, camera, max_range
- ``progress``: views, distance [m], known_fraction, entropy_bits, mean_sigma [m], surface_voxels,
  known_voxels, precise_fraction, interest_fraction, state
- ``decision``: view (index), pose (16 numbers, row by row, ``T_map_camera``) or null, base (x, y,
  yaw), position_sigma [m], strategy, rating, terms, reason, seconds (by stage), candidates
- ``motion``: action, outcome (empty when it succeeded), path (points [m])
- ``message``: text, level
- ``end``: reason, detail
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np


class RunLog(Protocol):
    """Where a run writes what it does."""

    def write(self, kind: str, **content: Any) -> None:
        """Add an entry."""


class RunLogFile:
    """A run log in a file, each line written at once.

    Args:
        path: the file; one that is there is continued when `append` is set, else replaced.
        append: continue the log of a run that was interrupted.
        clock: seconds; only differences count.
        robot_clock: what the robot takes for the time [s], in simulation the simulated time; None
            where that is not told.
        on_entry: called with each entry, for example to show progress.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        append: bool = False,
        clock: Callable[[], float] = time.monotonic,
        on_entry: Callable[[Mapping[str, Any]], None] | None = None,
        robot_clock: Callable[[], float] | None = None,
    ) -> None:
        self._path = Path(path)
        self._before = last_time(self._path) if append else 0.0
        if not append:
            self._path.write_text("", encoding="utf-8")
        elif self._path.exists() and not self._path.read_bytes().endswith(b"\n"):
            self._add("\n")  # the process was killed within a line
        self._clock, self._start = clock, clock()
        self._on_entry, self._robot_clock = on_entry, robot_clock

    def write(self, kind: str, **content: Any) -> None:
        """Add an entry; numbers that are not finite become null.

        Raises:
            OSError: the file cannot be written.
        """
        seconds = self._before + self._clock() - self._start
        told = {} if self._robot_clock is None else {"clock": round(self._robot_clock(), 3)}
        entry = {"t": round(seconds, 3), "kind": kind, **told, **plain(content)}
        self._add(json.dumps(entry, allow_nan=False) + "\n")
        if self._on_entry:
            self._on_entry(entry)

    def _add(self, text: str) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(text)


def last_time(path: Path) -> float:
    """Time of the last whole entry of a log [s]; 0 where there is none."""
    if not path.exists():
        return 0.0
    for line in reversed(path.read_text(encoding="utf-8", errors="replace").splitlines()):
        try:
            return float(json.loads(line)["t"])
        except (ValueError, KeyError, TypeError):
            continue
    return 0.0


def plain(value: Any) -> Any:
    """A value as JSON has it; floats with 6 significant digits."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value
