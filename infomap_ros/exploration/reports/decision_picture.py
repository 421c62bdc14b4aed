"""A picture of one decision for documents: candidates, the chosen view, and why."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.records.log_records import Decision
from infomap_ros.exploration.records.recorded_run import RecordedRun
from infomap_ros.exploration.reports.report_page.axes import number
from infomap_ros.exploration.reports.report_page.scene import BASE_ACTIONS, COLOR_MAPS, unit_of
from infomap_ros.exploration.reports.report_page.tables import kinds_of_rejections, words
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import map_from_above

_BASE, _CAMERA, _CHOSEN, _REJECTED = "#d55e00", "#0072b2", "#1c2127", "#5b6570"
_ARROW = 0.3  # in which direction a view looks [m]


def draw_decision(run: RecordedRun, step: int, voxel_map: VoxelMap, path: str | Path) -> None:
    """Draw a decision over the map from above, with its terms and what was rejected.

    Args:
        run: of which the decision is one.
        step: its place in ``run.steps``.
        voxel_map: what the robot knew, or came to know.
        path: PNG file to write.

    Raises:
        InvalidInputError: there is no such step, or the map has no surface to draw.
        OSError: the file cannot be written.
    """
    if not 0 <= step < len(run.steps):
        raise InvalidInputError("step", f"is {step}, but the run has {len(run.steps)} decisions")
    decision = run.steps[step].decision
    figure = Figure(figsize=(12.0, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    parts: dict[str, Axes] = figure.subplot_mosaic(
        [["plan", "terms"], ["plan", "rejected"]], width_ratios=(1.5, 1.0)
    )
    _draw_map(parts["plan"], voxel_map)
    _draw_paths(parts["plan"], run, step)
    _draw_candidates(parts["plan"], decision)
    _draw_chosen(parts["plan"], decision)
    _draw_terms(parts["terms"], decision)
    _draw_rejections(parts["rejected"], decision)
    figure.savefig(path, dpi=110, bbox_inches="tight")


def _draw_map(axes: Axes, voxel_map: VoxelMap) -> None:
    image = map_from_above(voxel_map, "gray")
    rows, columns = image.pixels.shape[:2]
    (x, y), cell = image.low, image.cell
    extent = (x, x + columns * cell, y, y + rows * cell)
    axes.imshow(image.pixels, origin="lower", extent=extent, alpha=0.4, interpolation="nearest")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _draw_paths(axes: Axes, run: RecordedRun, step: int) -> None:
    """Paths until the decision."""
    for before in run.steps[:step]:
        for motion in before.motions:
            color = _BASE if motion.action in BASE_ACTIONS else _CAMERA
            axes.plot(*motion.path[:, :2].T, color=color, linewidth=1.5)
    axes.plot([], [], color=_BASE, label="path of the base")
    axes.plot([], [], color=_CAMERA, label="path of the camera")


def _draw_candidates(axes: Axes, decision: Decision) -> None:
    rejected = [c for c in decision.candidates if c.rejection or not np.isfinite(c.rating)]
    possible = [c for c in decision.candidates if not c.rejection and np.isfinite(c.rating)]
    if rejected:
        x, y = np.array([c.position[:2] for c in rejected]).T
        axes.scatter(x, y, s=14, marker="x", color=_REJECTED, linewidth=0.9, label="rejected")
    if possible:
        x, y = np.array([c.position[:2] for c in possible]).T
        u, v = np.array([c.direction[:2] for c in possible]).T * _ARROW
        ratings, colors = np.array([c.rating for c in possible]), COLOR_MAPS["rating"]
        lengths = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.003}
        axes.quiver(x, y, u, v, ratings, cmap=colors, zorder=3, **lengths)
        marks = axes.scatter(x, y, s=28, c=ratings, cmap=colors, edgecolor="black", zorder=3)
        axes.figure.colorbar(marks, ax=axes, label="rating", shrink=0.7)


def _draw_chosen(axes: Axes, decision: Decision) -> None:
    if decision.pose is not None:
        x, y = decision.pose[:2, 3]
        ahead = decision.pose[:2, 2] * 2.0 * _ARROW
        axes.annotate(
            "",
            (x + ahead[0], y + ahead[1]),
            (x, y),
            arrowprops={"arrowstyle": "-|>", "color": _CHOSEN, "linewidth": 2.0},
            zorder=7,
        )
        axes.plot(x, y, "o", color=_CHOSEN, markeredgecolor="white", markersize=16, zorder=8)
        axes.plot([], [], "o", color=_CHOSEN, label="chosen")
        text = str(decision.view)
        axes.text(x, y, text, color="white", ha="center", va="center", fontsize=9, zorder=9)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, fontsize=8, frameon=False)


def _draw_terms(axes: Axes, decision: Decision) -> None:
    axes.axis("off")
    name = f"View {decision.view}" if decision.pose is not None else "No view"
    axes.set_title(name, loc="left", fontweight="bold")
    lines = [*textwrap.wrap(decision.reason, 58), ""]
    values = {**decision.terms, "rating": decision.rating}
    for term, value in values.items():
        if value == 0.0:
            continue
        lines.append(f"{words(term)} {unit_of(term)}".strip() + f":  {number(value)}")
    lines.append("")
    lines.append(f"{decision.considered} candidates, {sum(decision.rejections.values())} rejected")
    axes.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=9, transform=axes.transAxes)


def _draw_rejections(axes: Axes, decision: Decision) -> None:
    counts = kinds_of_rejections([decision]).most_common(8)[::-1]
    if not counts:
        axes.axis("off")
        return
    for place, (kind, count) in enumerate(counts):
        axes.text(0.0, place + 0.28, f"{count}  {kind}", fontsize=9, va="bottom")
    axes.barh(range(len(counts)), [count for _, count in counts], height=0.45, color=_CAMERA)
    axes.set_title("Rejected, and why", loc="left", fontweight="bold")
    axes.set(xticks=[], yticks=[], ylim=(-0.5, max(len(counts), 5) + 0.1))
    axes.spines[:].set_visible(False)
