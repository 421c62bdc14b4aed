"""What a planar study leaves: tables, figures and one flat object of figures."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from infomap_ros.studies.planar.figures import Axis, band_note, draw_curves, draw_ways
from infomap_ros.studies.planar.measures import CONFIDENCE, Band, band
from infomap_ros.studies.planar.planar_study import (
    OWN,
    PlanarStudyConfig,
    Row,
    compare,
    kinds_in,
    row_of,
    values_of,
)
from infomap_ros.studies.planar.tasks import Record


def rows_of(records: Sequence[Record], config: PlanarStudyConfig) -> list[Row]:
    """One row per exploration."""
    return [row_of(record, config) for record in records]


def write_csv(rows: Sequence[object], path: Path) -> None:
    """Write dataclass objects, one per line."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        if rows:
            names = [field.name for field in dataclasses.fields(rows[0])]  # type: ignore[arg-type]
            writer.writerow(names)
            writer.writerows([_text(getattr(row, name)) for name in names] for row in rows)


def write_curves(records: Sequence[Record], path: Path) -> None:
    """Write fraction, distance and time of every scan, one line each."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["world", "strategy", "scan", "fraction", "distance_m", "seconds"])
        for record in records:
            result = record.result
            columns = zip(result.fraction, result.distance, result.seconds, strict=True)
            for scan, (fraction, distance, seconds) in enumerate(columns, 1):
                numbers = f"{fraction:.5f}", f"{distance:.2f}", f"{seconds:.4f}"
                writer.writerow([str(record.task.world), record.task.label, scan, *numbers])


def _text(value: object) -> object:
    return f"{value:.5g}" if isinstance(value, float) else value


def overview(rows: Sequence[Row], config: PlanarStudyConfig) -> str:
    """Means by strategy as a Markdown table."""
    percent = f"{100 * CONFIDENCE:.0f} %"
    lines = [
        f"| strategy | worlds | mapped after {config.scans} scans [%] | area under coverage per "
        f"distance, {config.reach:g} m [%] | distance to {100 * config.share:g} % [m] "
        "| not reached in | choice of a view, processor time [s] |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in dict.fromkeys(row.strategy for row in rows):
        ways = values_of(rows, name, "distance_to_share")
        found = np.isfinite(ways)
        seconds = values_of(rows, name, "seconds")
        lines.append(
            f"| {name} | {len(ways)} | {_percent(band(values_of(rows, name, 'fraction')))} "
            f"| {_percent(band(values_of(rows, name, 'area')))} "
            f"| {_metres(band(ways[found]))} | {np.count_nonzero(~found)} | {seconds.mean():.2f} |"
        )
    return "\n".join(lines) + f"\n\nMean ± half width of the {percent} band over worlds.\n"


def comparisons(rows: Sequence[Row], config: PlanarStudyConfig) -> str:
    """The package's strategies against all others, by kind of world, as a Markdown table."""
    lines = [
        f"| strategy | against | worlds | difference of the area [%] | saved on the way to "
        f"{100 * config.share:g} % [%] |",
        "| --- | --- | --- | --- | --- |",
    ]
    names = list(dict.fromkeys(row.strategy for row in rows))
    for own in (name for name in OWN if name in names):
        for other in (name for name in names if name != own):
            for kind in ("all", *kinds_in(rows)):
                found = compare(rows, own, other, kind)
                note = f" (at least, in {found.bounds})" if found.bounds else ""
                note += f", {found.failed} not reached" if found.failed else ""
                lines.append(
                    f"| {own} | {other} | {kind}, {found.area.count} | {_percent(found.area)} "
                    f"| {_percent(found.saved)}{note} |"
                )
    return "\n".join(lines) + "\n"


def summary(rows: Sequence[Row], seconds: float) -> dict[str, float | str]:
    """One flat object of figures."""
    figures: dict[str, float | str] = {"worlds": len({row.world for row in rows})}
    figures["seconds"] = round(seconds, 1)
    names = list(dict.fromkeys(row.strategy for row in rows))
    for name in names:
        for value in ("fraction", "area", "seconds"):
            mean = float(values_of(rows, name, value).mean())
            figures[f"{name}.{value}"] = round(mean, 4)
        ways = values_of(rows, name, "distance_to_share")
        if np.isfinite(ways).any():
            mean = float(ways[np.isfinite(ways)].mean())
            figures[f"{name}.distance_to_share"] = round(mean, 1)
    for own in (name for name in OWN if name in names):
        for other in (name for name in names if name != own):
            found = compare(rows, own, other)
            figures[f"{own}.saved_against.{other}"] = round(found.saved.mean, 4)
    return {name: value for name, value in figures.items() if value == value}


def draw_figures(records: Sequence[Record], config: PlanarStudyConfig, out: Path) -> None:
    """Figs. 11, 13 and 14, and coverage against distance by kind of world."""
    if not records:
        return
    worlds = len({str(record.task.world) for record in records})
    scans, metres = Axis("scans", config.scans), Axis("distance", config.reach)
    kinds = list(dict.fromkeys(record.task.world.kind for record in records))
    note = band_note(worlds)
    panels = [("all", scans, "fraction"), ("all", scans, "distance"), ("all", metres, "fraction")]
    draw_curves(records, panels, out / "planar_curves", f"Fig. 11 over many worlds: {note}")
    by_kind = [(kind, metres, "fraction") for kind in kinds]
    draw_curves(records, by_kind, out / "planar_by_kind", f"By kind of world: {note}")
    first = [r for r in records if str(r.task.world) == str(records[0].task.world)]
    shown = ("random", "largest_information", "look_ahead")
    chosen = [record for record in first if record.task.label in shown]
    if chosen:
        world = chosen[0].task.world.make()
        draw_ways(world, chosen, config.sensor, config.scans, out / "planar_ways")


def team_overview(records: Sequence[Record], scans: int) -> str:
    """Fraction and distance of each strategy after all scans, as a Markdown table."""
    lines = [
        f"| strategy | worlds | mapped after {scans} scans [%] | distance moved [m] |",
        "| --- | --- | --- | --- |",
    ]
    for name in dict.fromkeys(record.task.label for record in records):
        own = [record.result for record in records if record.task.label == name]
        mapped = band(np.array([result.fraction[-1] for result in own]))
        moved = band(np.array([result.distance[-1] for result in own]))
        lines.append(f"| {name} | {len(own)} | {_percent(mapped)} | {_metres(moved)} |")
    return "\n".join(lines) + "\n"


def draw_team_figures(records: Sequence[Record], scans: int, out: Path) -> None:
    """Fig. 12."""
    if records:
        axis = Axis("scans", scans)
        panels = [("all", axis, "fraction"), ("all", axis, "distance")]
        note = band_note(len({str(record.task.world) for record in records}))
        draw_curves(records, panels, out / "two_curves", f"Fig. 12 over many worlds: {note}")


def _percent(found: Band) -> str:
    return _band(found, 100.0, 1)


def _metres(found: Band) -> str:
    return _band(found, 1.0, 0)


def _band(found: Band, factor: float, digits: int) -> str:
    if not found.count:
        return "-"
    mean = f"{factor * found.mean:.{digits}f}"
    return mean if found.count < 2 else f"{mean} ± {factor * found.half:.{digits}f}"
