"""A box of the user's own in which the map is to be better."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from infomap_ros.viewer.colors import PLACE

_EDGES = np.array(
    [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]
)  # of a cube, pairs of its corners
_SIGNS = np.array([[i >> axis & 1 for axis in range(3)] for i in range(8)]) - 0.5


@dataclass(frozen=True)
class InterestBox:
    """A place of interest.

    Attributes:
        center: of the box [m, map].
        size: its edges along the axes of the map [m].
        weight: factor by which information inside counts.
    """

    center: tuple[float, float, float]
    size: tuple[float, float, float]
    weight: float


class InterestControls:
    """Lets the user place a box, and hands it on.

    Args:
        viser: the server.
        on_change: given the box, or None where there is none any more.
        middle: where a new box is put, shape (3,) [m, map].
    """

    def __init__(
        self,
        viser: Any,
        on_change: Callable[[InterestBox | None], None],
        middle: Callable[[], Any],
    ) -> None:
        self._viser, self._on_change, self._middle = viser, on_change, middle
        self._handle: Any = None
        gui = viser.gui
        self._size = gui.add_vector3("Size [m]", (0.6, 0.6, 0.6), min=(0.05,) * 3, step=0.05)
        self._weight = gui.add_number("Weight", 3.0, min=0.0, max=100.0, step=0.5)
        gui.add_button("Place a box").on_click(lambda _: self._begin())
        gui.add_button("Send").on_click(lambda _: self._send())
        gui.add_button("Remove").on_click(lambda _: self._remove())
        self._size.on_update(lambda _: self._draw())

    def _begin(self) -> None:
        middle = tuple(float(value) for value in self._middle())
        self._handle = self._viser.scene.add_transform_controls(
            "/interest", scale=0.5, disable_rotations=True, position=middle
        )
        self._draw()

    def _draw(self) -> None:
        if self._handle is None:
            return
        corners = _SIGNS * np.asarray(self._size.value)
        self._viser.scene.add_line_segments(
            "/interest/box", corners[_EDGES].astype(np.float32), PLACE, thickness=3.0,
            thickness_units="screen",
        )  # fmt: skip

    def _send(self) -> None:
        if self._handle is None:
            self._begin()
        x, y, z = (float(value) for value in self._handle.position)
        length, width, height = (float(value) for value in self._size.value)
        weight = float(self._weight.value)
        self._on_change(InterestBox((x, y, z), (length, width, height), weight))

    def _remove(self) -> None:
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
        self._on_change(None)
