"""What a planar study leaves: tables, figures and one flat object of figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.figure_style import (
    CONFIDENCE,
    Band,
    band,
    band_note,
    draw_band,
    save,
    style_of,
)
from infomap_ros.studies.planar.planar_study import (
    BASELINES,
    OWN,
    Comparison,
    PlanarStudyConfig,
    Row,
    compare,
    kinds_in,
    least_distances,
    row_of,
    savings_of,
    values_of,
)
from infomap_ros.studies.planar.tasks import Record, fraction_at, label_of
from infomap_ros.studies.planar.world import (
    BoolArray,
    PlanarWorld,
    SensorConfig,
    level_pose,
    take_scan,
)
from infomap_ros.studies.runs import markdown, write_lines

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


def draw_paths(
    world: PlanarWorld, records: Sequence[Record], sensor: SensorConfig, scans: int, path: Path
) -> None:
    """Draw what each strategy has mapped of a world, and the path it flew: Figs. 10, 13 and 14.

    Args:
        world: that was explored.
        records: one per strategy.
        sensor: that measured.
        scans: so many of them.
        path: without suffix; PNG and SVG are written.
    """
    columns = 1 + len(records)
    figure = Figure(figsize=(3.1 * columns, 3.9), layout="constrained")
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
    """The part of the path that ends at a place."""
    last = np.flatnonzero(np.all(np.isclose(corners, end), axis=1))
    return corners[: int(last[-1]) + 1] if len(last) else corners


def rows_of(records: Sequence[Record], config: PlanarStudyConfig) -> list[Row]:
    """One row per exploration."""
    return [row_of(record, config) for record in records]


def write_curves(records: Sequence[Record], path: Path) -> None:
    """Write fraction, distance and time of every scan, one line each."""
    names = ["world", "strategy", "scan", "fraction", "distance_m", "seconds"]
    write_lines(names, (line for record in records for line in _lines(record)), path)


def _lines(record: Record) -> Iterator[list[object]]:
    result = record.result
    columns = zip(result.fraction, result.distance, result.seconds, strict=True)
    for scan, values in enumerate(columns, 1):
        yield [str(record.task.world), record.task.label, scan, *map(float, values)]


def overview(rows: Sequence[Row], config: PlanarStudyConfig) -> str:
    """Means by strategy as a Markdown table."""
    names = (
        "strategy",
        "worlds",
        f"mapped after {config.scans} scans [%]",
        f"area under coverage per distance, {config.reach:g} m [%]",
        f"distance to {100 * config.share:g} % [m]",
        "not reached in",
        "scans",
        "choice of a view, mean and longest processor time [ms]",
    )
    lines = [_overview_line(rows, name) for name in dict.fromkeys(row.strategy for row in rows)]
    note = (
        f"Mean ± half width of the {100 * CONFIDENCE:.0f} % band over worlds. Where a strategy did "
        "not get so far, all its distance counts, and it is at least the number given. "
        "The first run of an installation compiles, which counts as choice.\n"
    )
    return markdown(names, lines) + "\n" + note


def _overview_line(rows: Sequence[Row], name: str) -> list[str]:
    distances, arrived = least_distances(rows, name)
    mean, most = values_of(rows, name, "seconds"), values_of(rows, name, "max_seconds")
    return [
        name,
        str(len(distances)),
        _percent(band(values_of(rows, name, "fraction"))),
        _percent(band(values_of(rows, name, "area"))),
        ("" if arrived.all() else "at least ") + band(distances).text(),
        str(np.count_nonzero(~arrived)),
        f"{values_of(rows, name, 'scans').mean():.0f}",
        f"{1000 * mean.mean():.0f}, {1000 * most.max():.0f}",
    ]


def comparisons(rows: Sequence[Row], config: PlanarStudyConfig) -> str:
    """The package's strategies against all others, by kind of world, as a Markdown table."""
    names = (
        "strategy",
        "against",
        "worlds",
        "difference of the area [points of %]",
        f"saved on the way to {100 * config.share:g} % [%]",
        "worlds with a bound only",
    )
    strategies = list(dict.fromkeys(row.strategy for row in rows))
    found = [
        compare(rows, own, other, kind)
        for own in OWN
        if own in strategies
        for other in strategies
        if other != own
        for kind in ("all", *kinds_in(rows))
    ]
    return markdown(names, map(_comparison_line, found))


def _comparison_line(found: Comparison) -> list[str]:
    bounds = {"at least": found.at_least, "at most": found.at_most, "unknown": found.unknown}
    return [
        found.own,
        found.other,
        f"{found.kind}, {found.area.count}",
        _percent(found.area),
        _percent(found.saved),
        ", ".join(f"{count} {name}" for name, count in bounds.items() if count),
    ]


def summary(rows: Sequence[Row], seconds: float) -> dict[str, float | str]:
    """One flat object of figures."""
    figures: dict[str, float | str] = {"worlds": len({row.world for row in rows})}
    figures["seconds"] = round(seconds, 1)
    names = list(dict.fromkeys(row.strategy for row in rows))
    for name in names:
        for value in ("fraction", "area", "seconds"):
            mean = float(values_of(rows, name, value).mean())
            figures[f"{name}.{value}"] = round(mean, 4)
        distances, arrived = least_distances(rows, name)
        key = "distance_to_share" if arrived.all() else "distance_to_share_at_least"
        figures[f"{name}.{key}"] = round(float(distances.mean()), 1)
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
    scans, meters = Axis("scans", config.scans), Axis("distance", config.reach)
    kinds = list(dict.fromkeys(record.task.world.kind for record in records))
    note = band_note(worlds)
    _draw_comparison(records, config, out)
    panels = [("all", scans, "fraction"), ("all", scans, "distance"), ("all", meters, "fraction")]
    draw_curves(records, panels, out / "planar_curves", f"Fig. 11 over many worlds: {note}")
    by_kind = [(kind, meters, "fraction") for kind in kinds]
    draw_curves(
        records,
        by_kind,
        out / "planar_by_kind",
        "By kind of world: mean, bands from three worlds on",
    )
    first = [r for r in records if str(r.task.world) == str(records[0].task.world)]
    chosen = [record for record in first if _is_shown(record.task.strategy)]
    if chosen:
        world = chosen[0].task.world.make()
        draw_paths(world, chosen, config.sensor, config.scans, out / "planar_paths")


def _is_shown(strategy: str) -> bool:
    """Whether its path is drawn: some of the study's own strategies, and all that a user brings."""
    shown = ("random", "largest_information", "look_ahead", "FrontierTour")
    return label_of(strategy) in shown or strategy not in PlanarStudyConfig().strategies


def _draw_comparison(records: Sequence[Record], config: PlanarStudyConfig, out: Path) -> None:
    rows = rows_of(records, config)
    names = list(dict.fromkeys(row.strategy for row in rows))
    others = [name for name in names if name in map(label_of, BASELINES)]
    if "look_ahead" in names and others:
        draw_savings(rows, "look_ahead", others, config.share, out / "planar_saved")


def team_overview(records: Sequence[Record], scans: int) -> str:
    """Fraction and distance of each strategy after all scans, as a Markdown table."""
    names = ("strategy", "worlds", f"mapped after {scans} scans [%]", "distance moved [m]")
    lines = []
    for name in dict.fromkeys(record.task.label for record in records):
        own = [record.result for record in records if record.task.label == name]
        mapped = band(np.array([result.fraction[-1] for result in own]))
        moved = band(np.array([result.distance[-1] for result in own]))
        lines.append([name, len(own), _percent(mapped), moved.text()])
    return markdown(names, lines)


def draw_team_figures(records: Sequence[Record], scans: int, out: Path) -> None:
    """Fig. 12."""
    if records:
        axis = Axis("scans", scans)
        panels = [("all", axis, "fraction"), ("all", axis, "distance")]
        note = band_note(len({str(record.task.world) for record in records}))
        draw_curves(records, panels, out / "two_curves", f"Fig. 12 over many worlds: {note}")


def _percent(found: Band) -> str:
    return found.text(100.0, 1)


_MARKERS = {"exact": "o", "at least": "^", "at most": "v"}
_SPREAD = 0.5  # width over which the kinds of worlds lie apart


def draw_savings(
    rows: Sequence[Row], own: str, others: Sequence[str], share: float, path: Path
) -> None:
    """Draw one point per world and other strategy, means with their bands; PNG and SVG.

    Args:
        rows: of all strategies and worlds.
        own: strategy that is compared with
        others: these.
        share: of the world, to which distances are compared.
        path: without suffix.
    """
    figure = Figure(figsize=(1.9 * len(others) + 2.2, 3.8), layout="constrained")
    axes, kinds = figure.subplots(), kinds_in(rows)
    styles, bounds = style_of(["mean", *kinds]), set[str]()
    for place, other in enumerate(others):
        for kind, shift in zip(kinds, np.linspace(-0.5, 0.5, len(kinds)) * _SPREAD, strict=True):
            for saved in savings_of(rows, own, other, kind):
                marker, color = _MARKERS.get(saved.kind), styles[kind]["color"]
                bounds.add(saved.kind)
                if marker:
                    axes.plot(place + shift, 100.0 * saved.share, marker, color=color, ms=5)
        known = [one.share for one in savings_of(rows, own, other) if one.kind in _MARKERS]
        mean = band(100.0 * np.array(known))
        axes.errorbar(place + 0.4, mean.mean, np.nan_to_num(mean.half), fmt="ks", capsize=4)
    for kind in kinds:
        axes.plot([], [], "o", color=styles[kind]["color"], label=kind)
    for name in sorted(bounds & {"at least", "at most"}):
        axes.plot([], [], _MARKERS[name], color="#777777", label=name)
    axes.plot([], [], "ks", label=f"mean, {100 * CONFIDENCE:.0f} % band")
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set_xticks(range(len(others)), others)
    axes.set_ylabel(f"distance saved by {own}\nuntil {100 * share:g} % are mapped [%]")
    axes.grid(axis="y", alpha=0.3)
    figure.legend(loc="outside right upper", fontsize=8)
    save(figure, path)
