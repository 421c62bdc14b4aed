"""What the run is doing, in words and as curves, and the buttons that steer it.

A box of the user's own in which the map is to be better.
"""

from __future__ import annotations

import html
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from infomap_ros.errors import InfomapError
from infomap_ros.viewer.shapes import PLACE

_LINES = 14  # of the log that are shown
_CURVE = 400  # points of the curves; of more, every other one is left out
_NOTICE = 6.0  # for which the answer to an order is shown [s]
_LEVELS = {"warning": "#b06000", "error": "#c5221f"}


def map_figures(
    known_fraction: float, precise_fraction: float, mean_sigma: float
) -> dict[str, str]:
    """How good a map is, for `RunPanel.show_state`; what is not finite is left out.

    Args:
        known_fraction: of what is to be mapped, 0 to 1.
        precise_fraction: of it, what is known precisely enough.
        mean_sigma: of the surface along its normal [m].
    """
    shares = {"known": known_fraction, "precise": precise_fraction}
    figures = {name: f"{share:.1%}" for name, share in shares.items() if math.isfinite(share)}
    return figures | (
        {"mean sigma": f"{1e3 * mean_sigma:.1f} mm"} if math.isfinite(mean_sigma) else {}
    )


def _bold(text: str) -> str:
    return f'<div style="padding:0 0.6em"><b>{html.escape(text)}</b></div>'


class RunPanel:
    """State, figures, curves, log and buttons.

    Args:
        viser: the server.
        orders: what buttons do, by their labels; an order returns its answer in words.
    """

    def __init__(self, viser: Any, orders: Mapping[str, Callable[[], str]]) -> None:
        self._viser, self._lock = viser, threading.Lock()
        gui = viser.gui
        self._state = gui.add_html(_bold("starting"))
        self._figures = gui.add_html("")
        self._orders = orders
        if orders:
            gui.add_button_group("Robot", tuple(orders)).on_click(self._give)
        self._curves = gui.add_uplot(
            (np.zeros(1), np.zeros(1), np.zeros(1)),
            (
                {"label": "s"},
                {"label": "known [%]", "stroke": "#0072b2", "width": 2},
                {"label": "precise [%]", "stroke": "#d55e00", "width": 2},
            ),
            scales={"x": {"time": False}, "y": {"range": (0.0, 105.0)}},
            height=190,
            visible=False,
        )
        self._points: list[tuple[float, float, float]] = []
        self._begin = time.monotonic()
        self._lines: deque[str] = deque(maxlen=_LINES)

    def add_log(self) -> None:
        """Put the log where the panel now goes on."""
        self._log = self._viser.gui.add_html("")

    def show_state(self, state: str, figures: Mapping[str, str]) -> None:
        """Say what the run is doing.

        Args:
            state: in a few words.
            figures: by name, each with its unit.
        """
        self._state.content = _bold(state)
        rows = "".join(
            f"<tr><td>{html.escape(name)}</td>"
            f'<td style="text-align:right"><b>{html.escape(value)}</b></td></tr>'
            for name, value in figures.items()
        )
        table = '<table style="width:100%;padding:0 0.6em;font-size:0.8em">'
        self._figures.content = f"{table}{rows}</table>"

    def add_point(self, known_fraction: float, precise_fraction: float) -> None:
        """Add to the curves how far the map is now, 0 to 1 each; NaN is left out."""
        if not np.isfinite([known_fraction, precise_fraction]).all():
            return
        seconds = time.monotonic() - self._begin
        with self._lock:
            self._points.append((seconds, 100.0 * known_fraction, 100.0 * precise_fraction))
            if len(self._points) > _CURVE:
                self._points = self._points[::2]
            columns = np.array(self._points).T
        self._curves.data = tuple(np.ascontiguousarray(column) for column in columns)
        self._curves.visible = len(self._points) > 1

    def say(self, text: str, level: str = "info") -> None:
        """Add a line to the log; level: info, warning or error."""
        color = _LEVELS.get(level, "inherit")
        seconds = time.monotonic() - self._begin
        line = (
            f'<div style="color:{color};margin-bottom:0.3em"><span style="opacity:0.6">'
            f"{seconds:.0f} s</span> {html.escape(text)}</div>"
        )
        with self._lock:
            self._lines.append(line)
            lines = "".join(reversed(self._lines))
        self._log.content = f'<div style="padding:0 0.6em;font-size:0.75em">{lines}</div>'

    def _give(self, event: Any) -> None:
        """Carry out what a button is for, and tell who has pressed it what came of it."""
        label = str(event.target.value)
        try:
            answer, color = self._orders[label](), None
        except InfomapError as error:
            answer, color = str(error), "red"
        self.say(f"{label}: {answer}", "info" if color is None else "error")
        if event.client is not None:
            event.client.add_notification(label, answer, auto_close_seconds=_NOTICE, color=color)


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
