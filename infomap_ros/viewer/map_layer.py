"""The map's surface on the page."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.exploration.reports.report_page.scene import COLOR_MAPS, scene_of
from infomap_ros.exploration.reports.report_page.surface import (
    LOG_ODDS_RANGE,
    SIGMA_RANGE,
    DrawnSurface,
    drawn_surface,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.viewer.colors import colored, gradient

_MOST_VOXELS = 120_000  # more are merged to larger ones: each change is sent as a whole
_LIGHT = np.array([0.35, 0.2, 0.92])  # from where it comes, map frame
_SHADE = 0.6  # brightness of what is turned away from the light
_NAME = "/map"
_EVERYTHING = 1e6  # height above which nothing is hidden [m]


class MapLayer:
    """Draws the surface voxels, colored by what the user picks.

    Args:
        viser: the server.
    """

    def __init__(self, viser: Any) -> None:
        self._viser, self._lock = viser, threading.Lock()
        self._surface: DrawnSurface | None = None
        self._middle, self._has_been_shown = np.zeros(3), False
        gui = viser.gui
        self._color = gui.add_dropdown(
            "Color", ("height", "sigma", "probability"), hint="what the colors of the map tell"
        )
        self._legend = gui.add_html("")
        self._cut = gui.add_slider(
            "Cut above [m]", -1.0, 5.0, 0.05, 5.0, hint="hides ceilings and tall walls"
        )
        for control in (self._color, self._cut):
            control.on_update(self._on_control)

    def _on_control(self, event: Any) -> None:
        """Draw anew what a user has changed; what this layer itself sets is drawn anyway."""
        if event.client is not None:
            self._draw()

    @property
    def middle(self) -> FloatArray:
        """Of what is shown, shape (3,) [m, map]."""
        with self._lock:
            return self._middle.copy()

    def show(self, voxel_map: VoxelMap) -> None:
        """Show the surface as it is now; called by one thread at a time."""
        surface = drawn_surface(voxel_map, _MOST_VOXELS)
        with self._lock:
            self._surface = surface
        self._draw()

    def _draw(self) -> None:
        with self._lock:
            if self._surface is None or not len(self._surface.cells):
                return
            self._draw_surface(self._surface)

    def _draw_surface(self, surface: DrawnSurface) -> None:
        manifest = scene_of(surface, None, None)["manifest"]
        low, high = manifest["focus"]
        self._adjust_to(np.array(low), np.array(high))
        centers = surface.centers
        cut = self._cut.value if self._cut.value < self._cut.max else _EVERYTHING
        shown = (surface.evidence >= surface.min_evidence) & (centers[:, 2] <= cut)
        colors = self._colors(surface, centers, manifest)
        shades = np.clip(surface.normals / 127.0 @ _LIGHT, 0.0, 1.0)
        lit = colors * (_SHADE + (1.0 - _SHADE) * shades[:, None])
        self._viser.scene.add_point_cloud(
            _NAME,
            centers[shown].astype(np.float32),
            lit[shown].astype(np.uint8),
            point_size=surface.size,
            point_shape="square",
            point_shading="flat",
            precision="float32",
        )

    def _colors(
        self, surface: DrawnSurface, centers: FloatArray, manifest: dict[str, Any]
    ) -> NDArray[np.uint8]:
        """Color of each voxel, and the legend to them."""
        kind = str(self._color.value)
        name = COLOR_MAPS[kind]
        if kind == "height":
            low, high = manifest["heights"]
            values, ends = centers[:, 2], (f"{low:.2f} m", f"{high:.2f} m")
        elif kind == "sigma":
            low, high = np.log(manifest["sigma"]["shown"])
            first, last = np.log(SIGMA_RANGE)
            values = first + surface.sigmas / 255.0 * (last - first)
            ends = (f"{1e3 * np.exp(low):.1f} mm", f"{1e3 * np.exp(high):.1f} mm")
        else:
            low, high = LOG_ODDS_RANGE
            values = low + surface.evidence / 255.0 * (high - low)
            ends = ("50 %", f"{100.0 / (1.0 + np.exp(-high)):.2f} %")
        self._legend.content = (
            '<div style="padding:0 0.6em 0.4em;font-size:0.75em">'
            f'<div style="height:0.7em;border-radius:3px;background:{gradient(name)}"></div>'
            f'<span>{ends[0]}</span><span style="float:right">{ends[1]}</span></div>'
        )
        return colored(values, low, high, name)

    def _adjust_to(self, low: FloatArray, high: FloatArray) -> None:
        """Look at the map from aside when there is one for the first time; let the cut reach it."""
        self._middle = 0.5 * (low + high)
        step = self._cut.step
        least, most = (float(step * round(end / step)) for end in (low[2] - 0.1, high[2] + 0.3))
        if least < self._cut.min or most > self._cut.max or not self._has_been_shown:
            is_open = self._cut.value >= self._cut.max
            self._cut.min, self._cut.max = least, most
            self._cut.value = most if is_open else min(self._cut.value, most)
        if self._has_been_shown:
            return
        self._has_been_shown = True
        middle, reach = self._middle, float(np.linalg.norm(high - low))
        place = middle + max(reach, 1.0) * np.array([-0.3, -0.42, 0.45])
        self._viser.initial_camera.look_at = tuple(middle)
        self._viser.initial_camera.position = tuple(place)
        for client in self._viser.get_clients().values():
            client.camera.position, client.camera.look_at = place, middle
