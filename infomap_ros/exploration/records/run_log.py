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

The lines of a run log as records.

A run log is a text file of JSON lines. Each has ``t``, the time since the start [s], and ``kind``;
what else belongs to a kind is what the records below hold. Lengths are in meters, points in the map
frame.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.atomic_file import appending, write_text
from infomap_ros.geometry.transforms import FloatArray


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
            write_text(self._path, "")
        else:
            self._add("")
            if self._path.read_bytes()[-1:] not in (b"", b"\n"):  # killed within a line
                self._add("\n")
        self._clock, self._start = clock, clock()
        self._on_entry, self._robot_clock = on_entry, robot_clock

    def write(self, kind: str, **content: Any) -> None:
        """Add an entry; numbers that are not finite become null.

        Raises:
            OSError: the file cannot be written.
        """
        seconds = self._before + self._clock() - self._start
        clock = {} if self._robot_clock is None else {"clock": round(self._robot_clock(), 3)}
        entry = {"t": round(seconds, 3), "kind": kind, **clock, **plain(content)}
        self._add(json.dumps(entry, allow_nan=False) + "\n")
        if self._on_entry:
            self._on_entry(entry)

    def _add(self, text: str) -> None:
        with appending(self._path) as file:
            file.write(text.encode("utf-8"))


def last_time(path: Path) -> float:
    """Time of the last whole entry of a log [s]; 0 where there is none."""
    if not path.is_file():
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


@dataclass(frozen=True, eq=False)
class Start:
    """What the run was asked to do.

    Attributes:
        time: since the start [s].
        task: the parameters of the task, flat.
        robot: name of the robot.
        world: name of the simulated world, empty for a real one.
        strategy: name of the strategy that chooses the views.
        voxel_size: [m]; NaN where the log does not tell.
        camera: the rectified camera; None where the log does not tell.
        max_range: of the sensor [m]; NaN where the log does not tell.
        clock: of the robot [s], in simulation the simulated time; NaN where not told.
    """

    time: float
    task: Mapping[str, Any]
    robot: str
    world: str
    strategy: str
    voxel_size: float
    camera: PinholeCamera | None
    max_range: float
    clock: float = math.nan


@dataclass(frozen=True)
class Progress:
    """How far the run is.

    Attributes:
        time: since the start [s].
        views: taken so far.
        distance: that the base has driven [m].
        known_fraction: of what is to be mapped, 0 to 1; NaN where it was not known.
        entropy_bits: what is left [bits].
        mean_sigma: of the surface along its normal [m].
        surface_voxels: with a surface.
        known_voxels: ever observed.
        precise_fraction: as known_fraction, of what is known precisely enough.
        state: what the robot was doing.
    """

    time: float
    views: int
    distance: float
    known_fraction: float
    entropy_bits: float
    mean_sigma: float
    surface_voxels: int
    known_voxels: int
    precise_fraction: float
    state: str


@dataclass(frozen=True, eq=False)
class Candidate:
    """A view that was considered.

    Attributes:
        position: of the camera, shape (3,) [m, map].
        direction: in which it looks, unit length, shape (3,), map frame.
        rating: NaN where it was not rated.
        terms: of the rating, by name.
        rejection: why it was not possible; empty where it was.
    """

    position: FloatArray
    direction: FloatArray
    rating: float
    terms: Mapping[str, float]
    rejection: str


@dataclass(frozen=True, eq=False)
class Decision:
    """One choice of the next view.

    Attributes:
        time: since the start [s].
        view: its number.
        pose: chosen T_map_camera (optical frame), shape (4, 4); None where no view was chosen.
        base: x, y [m] and yaw [rad] of the base at the view, shape (3,); None where not told.
        strategy: that chose.
        rating: of the chosen view; NaN where there is none.
        terms: of that rating, by name.
        reason: why this view, or why none.
        seconds: that each stage took, by name.
        candidates: that were considered, or a choice of them.
        considered: number of all candidates.
        rejections: how many of all candidates were rejected, by reason.
        position_sigma: root of the trace of the camera's position covariance at the choice [m];
            NaN where not told.
        clock: of the robot [s], in simulation the simulated time; NaN where not told.
        surface: what of the surface was new, see `surface_growth`; empty where not told.
    """

    time: float
    view: int
    pose: FloatArray | None
    base: FloatArray | None
    strategy: str
    rating: float
    terms: Mapping[str, float]
    reason: str
    seconds: Mapping[str, float]
    candidates: tuple[Candidate, ...]
    considered: int
    rejections: Mapping[str, int]
    position_sigma: float = math.nan
    clock: float = math.nan
    surface: str = ""


@dataclass(frozen=True, eq=False)
class Motion:
    """One movement.

    Attributes:
        time: of its end, since the start [s].
        action: "drive", "arm", "look", "home" or "last look".
        outcome: why it failed; empty when done.
        path: along which the base (drive, home) or the camera went, shape (N, 3) [m, map].
        clock: of the robot at the end [s], in simulation the simulated time; NaN where not told.
    """

    time: float
    action: str
    outcome: str
    path: FloatArray
    clock: float = math.nan


@dataclass(frozen=True)
class Message:
    """Something worth telling: time [s], text, and level "info", "warning" or "error"."""

    time: float
    text: str
    level: str


@dataclass(frozen=True)
class End:
    """Why the run ended: time [s], the reason in a few fixed words, and details."""

    time: float
    reason: str
    detail: str


Record = Start | Progress | Decision | Motion | Message | End


def rating_text(rating: float | None, terms: Mapping[str, float]) -> str:
    """A rating and what it is made of; terms that are zero are left out.

    Args:
        rating: of the view; None or NaN where it was not rated.
        terms: of the rating, by name.
    """
    parts = ", ".join(f"{name.replace('_', ' ')} {number(v)}" for name, v in terms.items() if v)
    return parts if rating is None or rating != rating else f"rating {number(rating)}: {parts}"


def number(value: float) -> str:
    """A number with three significant digits, and no exponent where it is large."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
