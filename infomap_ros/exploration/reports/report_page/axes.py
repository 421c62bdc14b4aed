"""Axes of pictures: round numbers, and numbers with their units as text."""

from __future__ import annotations

import math
from collections.abc import Sequence

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
