"""Line charts as SVG that takes its colors from the page, so that it fits light and dark.

Axes of pictures: round numbers, and numbers with their units as text.
"""

from __future__ import annotations

import html
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"))
_THIN_SPACE = "\u2009"
MINUS, DASH = "\u2212", "\u2013"
"""Signs of typography: before a negative number, and in place of a value that there is not."""


def round_ticks(low: float, high: float, wanted: int = 5) -> list[float]:
    """About `wanted` round numbers from `low` to `high`, their step 1, 2 or 5 times 10^n."""
    span = high - low
    if not span > 0.0 or not math.isfinite(span):
        return [low]
    step = rounded_up(span / max(wanted, 1), 1e-3)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(i * step, 12) for i in range(first, last + 1)]


def rounded_up(value: float, tolerance: float, steps: Sequence[float] = (1, 2, 5, 10)) -> float:
    """The next of ..., 0.1, 0.2, 0.5, 1, 2, 5, ..., which may be a share `tolerance` too small."""
    power = 10.0 ** math.floor(math.log10(value))
    least = (1.0 - tolerance) * value
    return next(f * power for f in steps if f * power >= least)


def prefix(value: float) -> tuple[float, str]:
    """The power of thousand that makes a value readable, and its SI prefix."""
    size = abs(value)
    return next((pair for pair in _PREFIXES if size >= 0.9995 * pair[0]), _PREFIXES[-1])


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """A value with its unit and an SI prefix, such as ``12.3 mm``; a dash where not finite."""
    if not math.isfinite(value):
        return DASH
    factor, name = prefix(value) if value else (1.0, "")
    return f"{number(value / factor, digits)}{_THIN_SPACE}{name}{unit}"


def number(value: float, digits: int = 3) -> str:
    """A number of so many significant digits; all those before the point; grouped by thousands."""
    if not math.isfinite(value):
        return DASH
    if value == 0.0:
        return "0"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    text = f"{value:,.{min(places, 9)}f}".replace(",", _THIN_SPACE)
    return (text.rstrip("0").rstrip(".") if "." in text else text).replace("-", MINUS)


def duration(seconds: float) -> str:
    """A time such as ``42 s``, ``3 min 05 s`` or ``1 h 12 min``."""
    whole = round(seconds)
    if whole < 60:
        return quantity(seconds, "s", 2) if seconds < 10 else f"{whole}{_THIN_SPACE}s"
    hours, minutes = whole // 3600, whole % 3600 // 60
    if hours:
        return f"{hours}{_THIN_SPACE}h {minutes:02d}{_THIN_SPACE}min"
    return f"{minutes}{_THIN_SPACE}min {whole % 60:02d}{_THIN_SPACE}s"


def percent(share: float) -> str:
    """A share as percent with one decimal; a dash where not finite."""
    return f"{100.0 * share:.1f}{_THIN_SPACE}%" if math.isfinite(share) else DASH


WIDTH, HEIGHT = 380.0, 220.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 14.0, 30.0, 40.0
_COLORS = 6  # of curves in the page's style


@dataclass(frozen=True)
class Curve:
    """What a chart shows.

    Attributes:
        title: of the chart, without the unit.
        unit: of the values; gets an SI prefix where `scaled`.
        xs: places along the axis.
        ys: values.
        x_label: name and unit of the axis.
        scaled: whether the unit takes an SI prefix.
        goal: value that the task asks for; None for none.
        low: least value of the axis; None: as the values ask for.
        high: likewise largest.
        name: of the curve, where there are several in a chart.
    """

    title: str
    unit: str
    xs: Sequence[float]
    ys: Sequence[float]
    x_label: str
    scaled: bool = False
    goal: float | None = None
    low: float | None = 0.0
    high: float | None = None
    name: str = ""


class _Frame:
    """From values to places in the picture."""

    def __init__(self, curve: Curve, points: Sequence[tuple[float, float]]) -> None:
        ys = [y for _, y in points] + ([] if curve.goal is None else [curve.goal])
        self.x_low, self.x_high = min(x for x, _ in points), max(x for x, _ in points)
        self.x_low = min(self.x_low, 0.0)
        self.x_high = self.x_high if self.x_high > self.x_low else self.x_low + 1.0
        self.y_low = min(ys) if curve.low is None else curve.low
        self.y_high = 1.06 * max(ys) if curve.high is None else curve.high
        self.y_high = self.y_high if self.y_high > self.y_low else self.y_low + 1.0

    def x(self, value: float) -> float:
        share = (value - self.x_low) / (self.x_high - self.x_low)
        return round(_LEFT + share * (WIDTH - _LEFT - _RIGHT), 1)

    def y(self, value: float) -> float:
        share = (value - self.y_low) / (self.y_high - self.y_low)
        return round(HEIGHT - _BOTTOM - share * (HEIGHT - _TOP - _BOTTOM), 1)


def line_chart(*curves: Curve) -> str:
    """Draw curves over one axis; values that are not finite are left out.

    Args:
        curves: one or more; all but the values and the name are taken from the first.

    Returns:
        An ``svg`` element, with its points as ``data-points`` for the page's pointer.
    """
    curve = curves[0]
    rows = [
        [(x, y) for x, y in zip(one.xs, one.ys, strict=True) if math.isfinite(x + y)]
        for one in curves
    ]
    if not any(rows):
        return f'<p class="empty">{html.escape(curve.title)}: no value in the log.</p>'
    largest = max(abs(y) for row in rows for _, y in row)
    factor, name = prefix(largest) if curve.scaled else (1.0, "")
    rows = [[(x, y / factor) for x, y in row] for row in rows]
    goal = None if curve.goal is None else curve.goal / factor
    unit = f"{name}{curve.unit}"
    frame = _Frame(_rescaled(curve, goal), [point for row in rows for point in row])
    label = f"{curve.title} [{unit}]" if unit else curve.title
    parts = [
        *_grid(frame, curve.x_label),
        f'<text class="title" x="{_LEFT}" y="16">{html.escape(label)}</text>',
        "" if goal is None else _goal(frame, goal),
    ]
    marks: list[tuple[float, float, str]] = []
    for number_of_run, (one, row) in enumerate(zip(curves, rows, strict=True)):
        parts += _drawn(frame, row, "" if len(curves) == 1 else run_class(number_of_run))
        tips = [_tip(x, y, curve, unit, one.name) for x, y in row]
        marks += [(frame.x(x), frame.y(y), tip) for (x, y), tip in zip(row, tips, strict=True)]
    return (
        f'<svg class="chart" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'aria-label="{html.escape(f"{label} over {curve.x_label}")}" '
        f'data-points="{html.escape(json.dumps(marks))}">{"".join(parts)}</svg>'
    )


def run_class(number_of_run: int) -> str:
    """Class of what belongs to one of several runs: its color, and dashes when these repeat."""
    again = " again" if number_of_run >= _COLORS else ""
    return f" run-{number_of_run % _COLORS}{again}"


def _drawn(frame: _Frame, points: Sequence[tuple[float, float]], kind: str) -> list[str]:
    """One curve with its points."""
    places = [(frame.x(x), frame.y(y)) for x, y in points]
    trace = " ".join(f"{x},{y}" for x, y in places)
    return [
        f'<polyline class="curve{kind}" points="{trace}"/>',
        *(f'<circle class="dot{kind}" cx="{x}" cy="{y}" r="2"/>' for x, y in places),
    ]


def _rescaled(curve: Curve, goal: float | None) -> Curve:
    return Curve(curve.title, "", (), (), "", False, goal, curve.low, curve.high)


def _grid(frame: _Frame, x_label: str) -> list[str]:
    parts = []
    for tick in round_ticks(frame.y_low, frame.y_high, 4):
        y = frame.y(tick)
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{WIDTH - _RIGHT}" y1="{y}" y2="{y}"/>')
        parts.append(f'<text class="tick end" x="{_LEFT - 6}" y="{y + 4}">{number(tick)}</text>')
    for tick in round_ticks(frame.x_low, frame.x_high, 6):
        x, y = frame.x(tick), HEIGHT - _BOTTOM
        parts.append(f'<line class="axis" x1="{x}" x2="{x}" y1="{y}" y2="{y + 4}"/>')
        parts.append(f'<text class="tick mid" x="{x}" y="{y + 16}">{number(tick)}</text>')
    y = HEIGHT - _BOTTOM
    parts.append(f'<line class="axis" x1="{_LEFT}" x2="{WIDTH - _RIGHT}" y1="{y}" y2="{y}"/>')
    middle = 0.5 * (_LEFT + WIDTH - _RIGHT)
    text = html.escape(x_label)
    parts.append(f'<text class="label mid" x="{middle}" y="{HEIGHT - 6}">{text}</text>')
    return parts


def _goal(frame: _Frame, goal: float) -> str:
    y = frame.y(goal)
    return (
        f'<line class="goal" x1="{_LEFT}" x2="{WIDTH - _RIGHT}" y1="{y}" y2="{y}"/>'
        f'<text class="tick goal-text" x="{_LEFT + 6}" y="{y - 4}">asked for</text>'
    )


def _tip(x: float, y: float, curve: Curve, unit: str, whose: str) -> str:
    name, _, rest = curve.x_label.partition(" [")
    at = f"{name} {number(x)}" + (f" {rest.rstrip(']')}" if rest else "")
    return f"{whose}: {number(y, 4)} {unit} at {at}".removeprefix(": ")
