"""Several explorations on one page: compared, or those of the robots of a team."""

from __future__ import annotations

import html
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.records.recorded_run import RecordedRun, read_run
from infomap_ros.exploration.records.run_log import Progress, Record, Start
from infomap_ros.exploration.reports.report_page import sections
from infomap_ros.exploration.reports.report_page.charts import (
    DASH,
    duration,
    percent,
    quantity,
    run_class,
)
from infomap_ros.exploration.reports.report_page.plan import plan
from infomap_ros.exploration.reports.report_page.scene import drawn_surface, scene_of
from infomap_ros.exploration.reports.report_page.sections import (
    Section,
    as_text,
    kinds_of_rejections,
    page,
    table,
    with_unit,
    words,
)
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import MapImage, map_from_above

LOG_FILE, MAP_FILE, SUMMARY_FILE = "exploration.jsonl", "map.infomap", "summary.json"

_SHARES = (0.5, 0.8, 0.9)  # of the surface, for which the views and the distance are told


@dataclass(frozen=True, eq=False)
class RunFolder:
    """What a folder holds of a run.

    Attributes:
        run: its log.
        map_file: None where there is none.
        figures: its summary, name -> value; empty where there is none.
    """

    run: RecordedRun
    map_file: Path | None
    figures: Mapping[str, object]


def read_folder(folder: Path) -> RunFolder:
    """Read what an exploration left in its folder.

    Raises:
        InvalidInputError: the folder holds no log of an exploration, or its summary is no summary.
        RunLogError: the log cannot be used; names the line and the reason.
    """
    log, summary = folder / LOG_FILE, folder / SUMMARY_FILE
    if not log.is_file():
        raise InvalidInputError(str(folder), f"holds no {LOG_FILE}, the log of an exploration")
    figures: object = {}
    if summary.is_file():
        try:
            figures = json.loads(summary.read_text(encoding="utf-8"))
        except ValueError as error:
            raise InvalidInputError(str(summary), f"is not JSON: {error}") from error
    if not isinstance(figures, dict):
        raise InvalidInputError(str(summary), "is no JSON object")
    map_file = folder / MAP_FILE
    return RunFolder(read_run(log), map_file if map_file.is_file() else None, figures)


def write_comparison(out: Path, folders: Mapping[str, Path]) -> None:
    """Write a page that compares explorations.

    Args:
        out: the HTML file.
        folders: of the runs, by the names that the page gives them.

    Raises:
        InvalidInputError: there are fewer than two runs, or a folder holds none.
        RunLogError: a log cannot be used; names the line and the reason.
        MapFileError: a map file cannot be used.
        OSError: the page cannot be written.
    """
    if len(folders) < 2:
        raise InvalidInputError("runs", "expected at least two to compare")
    found = {name: read_folder(folder) for name, folder in folders.items()}
    runs = {name: one.run for name, one in found.items()}
    curves = sections.charts({name: run.of(Progress) for name, run in runs.items()})
    asked = _rows(_asked(run) for run in runs.values())
    parts = [
        Section("asked", "What was asked differently", _differences(asked, runs)),
        Section("results", "Results", _table(_rows(map(_results, runs.values())), runs)),
        Section("progress", "Progress", f'<div class="charts">{curves}</div>'),
        Section("figures", "Figures", _table(_rows(_numbers(one) for one in found.values()), runs)),
        Section("rejected", "Rejected candidates, by reason", _rejections(runs)),
        Section("maps", "The maps from above", _maps(found)),
    ]
    text = page("Explorations compared", "", _lead(runs), None, parts)
    write_text(out, text)


def _lead(runs: Mapping[str, RecordedRun]) -> str:
    """Each run with its color and how it ended."""
    lines = []
    for place, (name, run) in enumerate(runs.items()):
        end = run.end
        ended = "not ended" if end is None else f"{end.reason}, {end.detail}".rstrip(", ")
        swatch = f'<i class="swatch{run_class(place)}"></i>'
        said = f"{swatch}<b>{html.escape(name)}</b>: {html.escape(ended)}"
        lines.append(f"<li>{said}{sections.problems(run)}</li>")
    return f'<ul class="runs">{"".join(lines)}</ul>'


def _asked(run: RecordedRun) -> dict[str, object]:
    start = run.start
    return {
        "robot": start.robot,
        "world": start.world,
        "strategy": start.strategy,
        "voxel size": quantity(start.voxel_size, "m"),
        "range": quantity(start.max_range, "m"),
        **{name: with_unit(name, value, TaskConfig) for name, value in start.task.items()},
    }


def _results(run: RecordedRun) -> dict[str, object]:
    """What came of a run, as text."""
    progress = run.of(Progress)
    rows: dict[str, object] = {"views": str(run.views)}
    rows["views that brought no look"] = str(sum(not step.taken for step in run.steps))
    rows["time"] = duration(run.seconds)
    if not progress:
        return rows
    last = progress[-1]
    rows |= {
        "driven": quantity(last.distance, "m"),
        "known": percent(last.known_fraction),
        "known precisely": percent(last.precise_fraction),
        "mean sigma": quantity(last.mean_sigma, "m"),
        "entropy left": quantity(last.entropy_bits, "bit"),
    }
    for share in _SHARES:
        first = next((record for record in progress if record.known_fraction >= share), None)
        text = DASH
        if first is not None:
            text = f"{first.views} views, {quantity(first.distance, 'm')}, {duration(first.time)}"
        rows[f"until {share:.0%} were known"] = text
    return rows


def _numbers(found: RunFolder) -> dict[str, object]:
    """What a summary tells in numbers; words of it stand above the table."""
    numbers = {name: v for name, v in found.figures.items() if isinstance(v, int | float)}
    return {name: with_unit(name, value) for name, value in numbers.items()}


def _rows(columns: Iterator[Mapping[str, object]]) -> dict[str, list[str]]:
    """Rows of a table from its columns; a dash where a column does not have a row."""
    every = list(columns)
    names = dict.fromkeys(name for column in every for name in column)
    return {name: [as_text(column.get(name)) or DASH for column in every] for name in names}


def _differences(rows: Mapping[str, Sequence[str]], runs: Mapping[str, RecordedRun]) -> str:
    different = {name: row for name, row in rows.items() if len(set(row)) > 1}
    return _table(different, runs) if different else "<p>Nothing: all were asked the same.</p>"


def _table(rows: Mapping[str, Sequence[str]], runs: Mapping[str, RecordedRun]) -> str:
    if not rows:
        return ""
    cells = [[html.escape(words(name)), *map(html.escape, row)] for name, row in rows.items()]
    return table(["", *(f"#{name}" for name in runs)], cells, "parameters")


def _rejections(runs: Mapping[str, RecordedRun]) -> str:
    counts = [kinds_of_rejections([step.decision for step in run.steps]) for run in runs.values()]
    rows = {
        kind: [f"{count[kind]:,}" for count in counts]
        for kind, _ in sum(counts, start=type(counts[0])()).most_common()
    }
    return _table(rows, runs)


def _maps(found: Mapping[str, RunFolder]) -> str:
    """The map of each run from above, with its paths."""
    drawn = []
    for place, (name, one) in enumerate(found.items()):
        image = _above(one.map_file)
        body = "<p>no surface, or no map file</p>" if image is None else plan(image, one.run)
        swatch = f'<i class="swatch{run_class(place)}"></i>'
        drawn.append(f"<div><h3>{swatch}{html.escape(name)}</h3>{body}</div>")
    return f'<div class="maps">{"".join(drawn)}</div>'


def _above(map_file: Path | None) -> MapImage | None:
    if map_file is not None:
        with suppress(InvalidInputError):  # no surface yet
            return map_from_above(VoxelMap.load(map_file))
    return None


_KEYS = (
    '<ul class="keys"><li><i class="key base"></i>paths of the bases, {names}</li>'
    '<li><i class="key camera"></i>paths of the cameras</li>'
    '<li><i class="key dot view"></i>chosen views, with their numbers</li></ul>'
)


def write_team_report(
    out: Path,
    logs: Mapping[str, Path],
    voxel_map: VoxelMap,
    title: str,
    figures: Mapping[str, object] | None = None,
) -> None:
    """Write the report of an exploration by several robots.

    Args:
        out: the HTML file.
        logs: run log of each robot, by its name.
        voxel_map: the map of all.
        title: heading of the page.
        figures: of the run, name -> value.

    Raises:
        RunLogError: a log is not a run log; names the line and the reason.
        InvalidInputError: there are no logs, or the map has no surface.
        OSError: the report cannot be written.
    """
    if not logs:
        raise InvalidInputError("team report", "there are no run logs")
    runs = {name: read_run(path) for name, path in logs.items()}
    everything = _together(list(runs.values()))
    above = map_from_above(voxel_map)
    scene = scene_of(drawn_surface(voxel_map), above.cut, everything)
    paths = plan(above, *runs.values())
    styles = [
        f"{'solid' if number == 0 else 'dashed'}: {html.escape(name)}"
        for number, name in enumerate(runs)
    ]
    keys = _KEYS.format(names=", ".join(styles))
    parts = [
        Section("progress", "Coverage over views, meters and time", _curves(runs)),
        Section("plan", "The paths of all robots", f'<div class="above">{paths}{keys}</div>'),
        Section("task", "Task", sections.parameters_table(everything.start.task, TaskConfig)),
        Section("figures", "Figures", sections.parameters_table(figures or {})),
    ]
    lead = "".join(_robot(place, *item) for place, item in enumerate(runs.items()))
    text = page(title, sections.subtitle(everything), lead, scene, parts)
    write_text(out, text)


def _together(runs: list[RecordedRun]) -> RecordedRun:
    """One run with the decisions and paths of all, one robot after the other."""
    records: list[Record] = [runs[0].start]
    for run in runs:
        records += [record for record in run.records if not isinstance(record, Start)]
    return RecordedRun(tuple(records), tuple(text for run in runs for text in run.problems))


def _robot(place: int, name: str, run: RecordedRun) -> str:
    """How a robot's exploration went, in one line of figures."""
    progress = run.of(Progress)
    tiles = [("views", str(run.views))]
    if progress:
        tiles += [
            ("driven", quantity(progress[-1].distance, "m")),
            ("known to it", percent(progress[-1].known_fraction)),
        ]
    tiles.append(("time", duration(run.seconds)))
    heading = f'<h3><i class="swatch{run_class(place)}"></i>{html.escape(name)}</h3>'
    return heading + sections.outcome(run) + sections.problems(run) + sections.tiles(tiles)


def _curves(runs: Mapping[str, RecordedRun]) -> str:
    """What each robot knew of the map of all, over its own views and meters, and over time."""
    axes = {"its views" if name == "views" else name: of for name, of in sections.AXES.items()}
    progress = {name: run.of(Progress) for name, run in runs.items()}
    goal = next(
        (goal for run in runs.values() if (goal := sections.goal_of(run)) is not None), None
    )
    drawn = sections.charts(progress, axes, [sections.KNOWN], {"known": goal})
    return f'<div class="charts">{drawn}</div>'
