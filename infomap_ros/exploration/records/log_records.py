"""The lines of a run log as records.

A run log is a text file of JSON lines. Each has ``t``, the time since the start [s], and ``kind``;
what else belongs to a kind is what the records below hold. Lengths are in meters, points in the map
frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray


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
    told = ", ".join(f"{name.replace('_', ' ')} {number(v)}" for name, v in terms.items() if v)
    return told if rating is None or rating != rating else f"rating {number(rating)}: {told}"


def number(value: float) -> str:
    """A number with three significant digits, and no exponent where it is large."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
