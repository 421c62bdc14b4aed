"""Tables of a study as CSV."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path


def write_rows(rows: Sequence[object], path: Path) -> None:
    """Write dataclass objects of one class, one per line."""
    names = [field.name for field in dataclasses.fields(rows[0])] if rows else []  # type: ignore[arg-type]
    write_lines(names, ([getattr(row, name) for name in names] for row in rows), path)


def write_lines(names: Sequence[str], lines: Iterable[Sequence[object]], path: Path) -> None:
    """Write a header and lines; floats with five digits."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([_text(value) for value in line] for line in lines)


def _text(value: object) -> object:
    return f"{value:.5g}" if isinstance(value, float) else value


def markdown(names: Sequence[str], lines: Iterable[Sequence[object]]) -> str:
    """A Markdown table."""
    rows = [names, ["---"] * len(names), *lines]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in rows) + "\n"
