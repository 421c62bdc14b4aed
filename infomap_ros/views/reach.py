"""Can a view be reached? The question that the choice asks, and what an answer holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from infomap_ros.geometry.transforms import FloatArray


class ReachResult(Protocol):
    """How a view is reached, or why it is not.

    Attributes:
        reason: empty where it can be reached, else a short sentence.
        travel: length of the base's path [m].
        route: the motion itself, for whoever executes it; not looked into here.
        partial: the route ends at the farthest safe approach, not at the view.
        seconds: time that the motion takes [s]; NaN where that is not known.
    """

    @property
    def reason(self) -> str: ...  # noqa: D102
    @property
    def travel(self) -> float: ...  # noqa: D102
    @property
    def route(self) -> object | None: ...  # noqa: D102
    @property
    def partial(self) -> bool: ...  # noqa: D102
    @property
    def seconds(self) -> float: ...  # noqa: D102


class Reachability(Protocol):
    """A robot that can be asked which views it reaches."""

    def may_reach(self, poses: FloatArray) -> Sequence[str]:
        """Cheap test of many views, ``T_map_camera`` (M, 4, 4): "" or the reason against each."""

    def reach(self, T_map_camera: FloatArray) -> ReachResult:
        """Plan the motion to one view, shape (4, 4)."""


@dataclass(frozen=True)
class Flight:
    """The `ReachResult` of a camera that flies."""

    reason: str = ""
    travel: float = 0.0
    route: object | None = None
    partial: bool = False
    seconds: float = float("nan")


class FlyingCamera:
    """A camera without a body: it reaches every view that the map allows, as in Figs. 10 to 12."""

    def __init__(self, T_map_camera: FloatArray) -> None:
        """Start at a pose, shape (4, 4)."""
        self._position = np.array(T_map_camera[:3, 3])

    def may_reach(self, poses: FloatArray) -> Sequence[str]:
        """Nothing speaks against any view, shape (M, 4, 4)."""
        return [""] * len(poses)

    def reach(self, T_map_camera: FloatArray) -> Flight:
        """Fly straight there, shape (4, 4)."""
        return Flight(travel=float(np.linalg.norm(T_map_camera[:3, 3] - self._position)))
