"""The run from above as SVG: the map as a picture, paths and views over it, axes in meters."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence

import cv2
import numpy as np

from infomap_ros.exploration.records.recorded_run import RecordedRun, Step
from infomap_ros.exploration.records.run_log import Motion
from infomap_ros.exploration.reports.report_page.charts import number, round_ticks
from infomap_ros.exploration.reports.report_page.scene import BASE_ACTIONS
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.files.pictures import MapImage

_SIZE = 820.0  # of the longer side of the drawing [px]
_LEFT, _RIGHT, _TOP, _BOTTOM = 78.0, 12.0, 12.0, 56.0  # room for 20 px of text on a phone


class _Sheet:
    """From map coordinates to places in the picture."""

    def __init__(self, low: FloatArray, high: FloatArray) -> None:
        self.low, self.high = low, high
        self.scale = _SIZE / float((high - low).max())
        self.width, self.height = (high - low) * self.scale + (_LEFT + _RIGHT, _TOP + _BOTTOM)

    def place(self, point: Sequence[float] | FloatArray) -> tuple[float, float]:
        x = _LEFT + (float(point[0]) - self.low[0]) * self.scale
        y = _TOP + (self.high[1] - float(point[1])) * self.scale
        return round(float(x), 1), round(float(y), 1)


def plan(image: MapImage, *runs: RecordedRun, camera_path: FloatArray | None = None) -> str:
    """Draw the map from above with the paths of base and camera and the chosen views.

    Args:
        image: the map.
        runs: of the robots; the paths of all but the first are dashed.
        camera_path: of a camera without a run, shape (N, 3) [m].
    """
    low = image.low
    high = low + np.array(image.pixels.shape[1::-1]) * image.cell
    sheet = _Sheet(*_box(low, high, runs, camera_path))
    parts = [_picture(sheet, image, low, high), *_axes(sheet)]
    for index, run in enumerate(runs):
        kind = " dashed" if index else ""
        parts += [_path(sheet, motion, kind) for motion in run.of(Motion) if len(motion.path) > 1]
    if camera_path is not None and len(camera_path) > 1:
        parts.append(_trace(sheet, camera_path, "camera"))
    steps = [step for run in runs for step in run.steps]
    parts += [_view(sheet, place, step) for place, step in enumerate(steps)]
    return (
        f'<svg class="plan" viewBox="0 0 {sheet.width:.0f} {sheet.height:.0f}" role="img" '
        f'preserveAspectRatio="xMinYMin" aria-label="The map and the run from above">'
        f"{''.join(parts)}</svg>"
    )


def _box(
    low: FloatArray, high: FloatArray, runs: Sequence[RecordedRun], path: FloatArray | None
) -> tuple[FloatArray, ...]:
    """The map and all that is drawn over it."""
    motions = [motion for run in runs for motion in run.of(Motion)]
    steps = [step for run in runs for step in run.steps]
    points = [motion.path[:, :2] for motion in motions]
    points += [s.decision.pose[None, :2, 3] for s in steps if s.decision.pose is not None]
    points += [] if path is None or not len(path) else [path[:, :2]]
    every = np.concatenate([low[None], high[None], *points])
    margin = 0.02 * float(np.ptp(every, axis=0).max())
    return every.min(axis=0) - margin, every.max(axis=0) + margin


def _picture(sheet: _Sheet, image: MapImage, low: FloatArray, high: FloatArray) -> str:
    rows = np.ascontiguousarray(image.pixels[::-1])
    _, png = cv2.imencode(".png", cv2.cvtColor(rows, cv2.COLOR_RGBA2BGRA))
    (x, y), (x_end, y_end) = sheet.place((low[0], high[1])), sheet.place((high[0], low[1]))
    data = base64.b64encode(png.tobytes()).decode("ascii")
    return (
        f'<image x="{x}" y="{y}" width="{x_end - x:.1f}" height="{y_end - y:.1f}" '
        f'preserveAspectRatio="none" href="data:image/png;base64,{data}"/>'
    )


def _axes(sheet: _Sheet) -> list[str]:
    left, right = _LEFT, sheet.width - _RIGHT
    top, bottom = _TOP, sheet.height - _BOTTOM
    parts = [
        f'<rect class="frame" x="{left}" y="{top}" width="{right - left:.1f}" '
        f'height="{bottom - top:.1f}"/>'
    ]
    for tick in round_ticks(sheet.low[0], sheet.high[0], 8):
        x, _ = sheet.place((tick, 0.0))
        parts.append(f'<line class="grid over" x1="{x}" x2="{x}" y1="{top}" y2="{bottom:.1f}"/>')
        parts.append(f'<text class="tick mid" x="{x}" y="{bottom + 20:.1f}">{number(tick)}</text>')
    for tick in round_ticks(sheet.low[1], sheet.high[1], 8):
        _, y = sheet.place((0.0, tick))
        parts.append(f'<line class="grid over" x1="{left}" x2="{right:.1f}" y1="{y}" y2="{y}"/>')
        parts.append(f'<text class="tick end" x="{left - 6}" y="{y + 4:.1f}">{number(tick)}</text>')
    middle = 0.5 * (top + bottom)
    turn = f'transform="rotate(-90 20 {middle:.1f})"'
    parts.append(
        f'<text class="label mid" x="{0.5 * (left + right):.1f}" y="{sheet.height - 6:.1f}">'
        f'x [m]</text><text class="label mid" x="20" y="{middle:.1f}" {turn}>y [m]</text>'
    )
    return parts


def _path(sheet: _Sheet, motion: Motion, kind: str) -> str:
    who = "base" if motion.action in BASE_ACTIONS else "camera"
    return _trace(sheet, motion.path, who + kind)


def _trace(sheet: _Sheet, path: FloatArray, who: str) -> str:
    trace = " ".join(f"{x},{y}" for x, y in map(sheet.place, path))
    return f'<polyline class="halo" points="{trace}"/><polyline class="{who}" points="{trace}"/>'


def _view(sheet: _Sheet, place: int, step: Step) -> str:
    """The camera as a numbered dot with a wedge in the direction in which it looks."""
    decision = step.decision
    if decision.pose is None:
        return ""
    x, y = sheet.place(decision.pose[:2, 3])
    ahead = decision.pose[:2, 2]
    angle = np.degrees(np.arctan2(-ahead[1], ahead[0]))
    length = 8.0 + 16.0 * float(np.linalg.norm(ahead))
    kind = "view taken" if step.taken else "view"
    title = html.escape(f"view {decision.view}: {decision.reason}")
    return (
        f'<g class="{kind}" data-step="{place}" transform="translate({x} {y})"><title>{title}'
        f'</title><path transform="rotate({angle:.1f})" d="M0 0L{length:.1f} -7V7Z"/>'
        f'<circle r="8.5"/><text class="mid" y="3.6">{decision.view}</text></g>'
    )
