"""The figures of the planar studies: curves with bands, and maps with the way flown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.common.figure_style import draw_band, save, style_of
from infomap_ros.studies.planar.measures import fraction_at
from infomap_ros.studies.planar.planar_study import OWN
from infomap_ros.studies.planar.sensor import SensorConfig, level_pose, take_scan
from infomap_ros.studies.planar.tasks import Record
from infomap_ros.studies.planar.world import BoolArray, PlanarWorld

_POINTS = 201
_LEAST_FOR_BANDS = 3  # worlds; the band over two is as wide as the figure


@dataclass(frozen=True)
class Axis:
    """What a curve is drawn over.

    Attributes:
        name: "scans" or "distance".
        last: where the axis ends.
    """

    name: str
    last: float

    @property
    def at(self) -> FloatArray:
        """Where the curve is drawn, shape (N,)."""
        if self.name == "scans":
            return np.arange(1.0, self.last + 1.0)
        return np.linspace(0.0, self.last, _POINTS)

    @property
    def label(self) -> str:
        """With the unit."""
        return "scans [-]" if self.name == "scans" else "distance moved [m]"


def curves_of(records: Sequence[Record], axis: Axis, value: str) -> FloatArray:
    """Curves of one strategy, one per world, shape (worlds, N).

    Args:
        records: of the strategy.
        axis: drawn over.
        value: "fraction" or "distance"; what was reached at the end stays.
    """
    rows = []
    for record in records:
        result = record.result
        if axis.name == "scans":
            index = np.minimum(axis.at.astype(int), len(result.fraction)) - 1
            rows.append(getattr(result, value)[index])
        else:
            rows.append(fraction_at(result.distance, result.fraction, axis.at))
    return np.array(rows)


def draw_curves(
    records: Sequence[Record], panels: Sequence[tuple[str, Axis, str]], path: Path, title: str
) -> None:
    """Draw means over worlds, from three on with their bands, as PNG and SVG.

    Args:
        records: of all strategies and worlds.
        panels: kind of worlds or "all", axis, and value of each panel.
        path: without suffix.
        title: of the figure.
    """
    strategies = list(dict.fromkeys(record.task.label for record in records))
    styles = style_of(strategies)
    for name in set(OWN) & set(strategies):
        styles[name]["linewidth"] = 2.6
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(4.6 * columns, 3.6 * rows + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (kind, axis, value) in zip(grid, panels, strict=False):
        worlds = [r for r in records if kind in ("all", r.task.world.kind)]
        for name in strategies:
            own = [record for record in worlds if record.task.label == name]
            if own:
                curves = curves_of(own, axis, value)
                if len(curves) < _LEAST_FOR_BANDS:
                    curves = curves.mean(axis=0, keepdims=True)
                draw_band(axes, axis.at, curves, styles[name], name)
        _label(axes, kind, axis, value, len({str(r.task.world) for r in worlds}))
    for axes in grid[len(panels) :]:
        axes.remove()
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8)
    figure.suptitle(title, fontsize=10)
    save(figure, path)


def _label(axes: Any, kind: str, axis: Axis, value: str, worlds: int) -> None:
    where = "all worlds" if kind == "all" else kind
    axes.set_title(f"{where} ({worlds})", fontsize=9)
    axes.set_xlabel(axis.label)
    axes.set_ylabel("fraction mapped [-]" if value == "fraction" else "distance moved [m]")
    axes.set_xlim(0.0, axis.last)
    axes.set_ylim(bottom=0.0)
    if value == "distance":  # bands over few worlds may reach far beyond the means
        axes.set_ylim(top=1.3 * max(line.get_ydata().max() for line in axes.lines))
    if value == "fraction" and axes.get_ylim()[1] > 0.5:
        axes.set_ylim(0.0, 1.0)
    axes.grid(alpha=0.3)


def draw_ways(
    world: PlanarWorld, records: Sequence[Record], sensor: SensorConfig, scans: int, path: Path
) -> None:
    """Draw what each strategy has mapped of a world, and the way it flew: Figs. 10, 13 and 14.

    Args:
        world: that was explored.
        records: one per strategy.
        sensor: that measured.
        scans: so many of them.
        path: without suffix; PNG and SVG are written.
    """
    columns = 1 + len(records)
    figure = Figure(figsize=(3.1 * columns, 3.9), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, columns, sharex=True, sharey=True, squeeze=False)[0]
    extent = (0.0, world.size[0], 0.0, world.size[1])
    axes[0].imshow(_shades(world, np.ones_like(world.occupied)), extent=extent, **_IMAGE)
    axes[0].plot(*world.start, "o", color="#D55E00", markersize=5)
    axes[0].set_title("the world; start in the middle", fontsize=9)
    for panel, record in zip(axes[1:], records, strict=True):
        views = record.result.views[:scans]
        known = world.known_cells(_map_from(world, sensor, views))
        panel.imshow(_shades(world, known), extent=extent, **_IMAGE)
        panel.plot(views[:, 0], views[:, 1], ".", color="#0072B2", markersize=3)
        corners = _flown(record.result.corners, views[-1, :2])
        panel.plot(corners[:, 0], corners[:, 1], color="#0072B2", linewidth=0.7)
        share = record.result.fraction[len(views) - 1]
        moved = record.result.distance[len(views) - 1]
        title = f"{record.task.label}\n{100 * share:.0f} % after {len(views)} scans, {moved:.0f} m"
        panel.set_title(title, fontsize=9)
    for panel in axes:
        panel.set_xlabel("x [m]")
    axes[0].set_ylabel("y [m]")
    save(figure, path)


_IMAGE: dict[str, Any] = {"origin": "lower", "cmap": "gray", "vmin": 0.0, "vmax": 1.0}


def _shades(world: PlanarWorld, known: BoolArray) -> FloatArray:
    """Black obstacles, gray empty space and white unknown, as in Fig. 13; rows along y."""
    shades = np.where(world.occupied, 0.0, 0.75)
    return np.asarray(np.where(known, shades, 1.0).T)


def _map_from(world: PlanarWorld, sensor: SensorConfig, views: FloatArray) -> VoxelMap:
    voxel_map = VoxelMap(sensor.map_config(world.cell))
    for x, y, azimuth in views:
        pose = level_pose(np.array([x, y]), azimuth, world.cell)
        take_scan(world.truth, sensor, pose, voxel_map)
    return voxel_map


def _flown(corners: FloatArray, end: FloatArray) -> FloatArray:
    """The part of the way that ends at a place."""
    last = np.flatnonzero(np.all(np.isclose(corners, end), axis=1))
    return corners[: int(last[-1]) + 1] if len(last) else corners
