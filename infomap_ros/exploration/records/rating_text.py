"""The rating of a view in words."""

from __future__ import annotations

from collections.abc import Mapping


def rating_text(rating: float | None, terms: Mapping[str, float]) -> str:
    """A rating and what it is made of; terms that are zero are left out.

    Args:
        rating: of the view; None or NaN where it was not rated.
        terms: of the rating, by name.
    """
    told = ", ".join(f"{name.replace('_', ' ')} {number(v)}" for name, v in terms.items() if v)
    return told if rating is None or rating != rating else f"rating {number(rating)}: {told}"


def number(value: float) -> str:
    """A number with three significant digits, and no exponent where it is large."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
