"""The views on the page: which were considered, which one was chosen, and the path there."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.viewer.shapes import BASE_PATH, CHOSEN, REJECTED, draw_path, frustum, place

_LENGTH = 0.14  # of the arrow of a view [m]
_STYLE = "margin:0.3em 0;padding:0 0.6em 0 0.8em;font-size:0.85em;overflow-wrap:anywhere"
_LISTED = 4  # views whose terms are told
_LIFT = np.array([0.0, 0.0, 0.03])  # of the base's path above the ground [m]


@dataclass(frozen=True, eq=False)
class ConsideredView:
    """A view that was considered.

    Attributes:
        position: of the camera, shape (3,) [m, map].
        direction: in which it looks, unit length, shape (3,), map frame.
        color: red, green, blue, 0 to 255.
        text: its rating in words, or why it was rejected.
        rejected: whether it was not possible.
    """

    position: FloatArray
    direction: FloatArray
    color: tuple[int, int, int]
    text: str
    rejected: bool


class ViewsLayer:
    """Draws views and paths, and says why.

    Args:
        viser: the server.
    """

    def __init__(self, viser: Any) -> None:
        self._scene = viser.scene
        self._chosen: Any = None
        self._reason = viser.gui.add_html(as_text("no view was chosen yet"))
        self._details = viser.gui.add_html("")

    def show(self, views: Sequence[ConsideredView]) -> None:
        """Show what was considered at a choice, the best first."""
        for name, rejected, width in (("rated", False, 1.0), ("rejected", True, 0.5)):
            self._draw(f"/views/{name}", [v for v in views if v.rejected == rejected], width)
        self._details.content = _summary(views)

    def show_chosen(
        self, T_map_camera: FloatArray | None, camera: PinholeCamera | None, reason: str
    ) -> None:
        """Show the view that was chosen.

        Args:
            T_map_camera: where the camera is to look from, shape (4, 4); None where none was.
            camera: tells how far it sees to the sides; None where that is not known.
            reason: why.
        """
        if self._chosen is None:
            self._chosen = frustum(self._scene, "/chosen_view", camera, CHOSEN)
        self._chosen.visible = T_map_camera is not None
        if T_map_camera is not None:
            place(self._chosen, T_map_camera)
        self.show_reason(reason)

    def show_reason(self, reason: str) -> None:
        """Say why a view was chosen, or why none."""
        self._reason.content = as_text(reason)

    def show_path(self, places: FloatArray) -> None:
        """Show the path of the base, shape (K, 3) [m, map]; K = 0 where it stays."""
        lifted = np.asarray(places, dtype=np.float64).reshape(-1, 3) + _LIFT
        draw_path(self._scene, "/base_path", lifted, BASE_PATH, 5.0)

    def _draw(self, name: str, views: Sequence[ConsideredView], width: float) -> None:
        if not views:
            self._scene.remove_by_name(name)
            return
        starts = np.stack([view.position for view in views])
        ends = starts + _LENGTH * np.stack([view.direction for view in views])
        colors = np.array([REJECTED if v.rejected else v.color for v in views], dtype=np.uint8)
        self._scene.add_arrows(
            name,
            np.stack([starts, ends], axis=1).astype(np.float32),
            colors,
            shaft_radius=0.008 * width,
            head_radius=0.022 * width,
            head_length=0.05,
        )


def _summary(views: Sequence[ConsideredView]) -> str:
    """The best views and why others were rejected, as HTML."""
    rated = [view.text for view in views if not view.rejected]
    rejected = Counter(view.text.split(":")[0] for view in views if view.rejected)
    text = as_text(f"{len(rated)} views rated, {rejected.total()} rejected (gray).")
    if rated:
        text += as_text("The best:") + _list(rated[:_LISTED])
    if rejected:
        reasons = [f"{count} x {reason}" for reason, count in rejected.most_common(_LISTED)]
        text += as_text("Rejected:") + _list(reasons)
    return text


def as_text(text: str) -> str:
    """A paragraph of HTML that shows words as they are, whoever sent them."""
    return f'<p style="{_STYLE}">{html.escape(text)}</p>'


def _list(lines: Sequence[str]) -> str:
    items = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
    return f'<ul style="{_STYLE}">{items}</ul>'
