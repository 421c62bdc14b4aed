"""The report of a team: one HTML file with the map in 3-D, the ways of all robots, their curves."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from pathlib import Path

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.records.log_records import Motion, Progress, Record, Start
from infomap_ros.exploration.records.recorded_run import RecordedRun, read_run
from infomap_ros.exploration.reports.report_page import sections, tables
from infomap_ros.exploration.reports.report_page.axes import duration, percent, quantity
from infomap_ros.exploration.reports.report_page.charts import Curve, line_chart, run_class
from infomap_ros.exploration.reports.report_page.page import Section, page
from infomap_ros.exploration.reports.report_page.plan import plan
from infomap_ros.exploration.reports.report_page.scene import scene_of
from infomap_ros.exploration.reports.report_page.surface import drawn_surface
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import map_from_above

_KEYS = (
    '<ul class="keys"><li><i class="key base"></i>ways of the bases, {names}</li>'
    '<li><i class="key camera"></i>ways of the cameras</li>'
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
    ways = plan(above, *runs.values())
    styles = [
        f"{'solid' if number == 0 else 'dashed'}: {html.escape(name)}"
        for number, name in enumerate(runs)
    ]
    keys = _KEYS.format(names=", ".join(styles))
    parts = [
        Section("progress", "Coverage over views, meters and time", _curves(runs)),
        Section("plan", "The ways of all robots", f'<div class="above">{ways}{keys}</div>'),
        Section("task", "Task", tables.parameters_table(everything.start.task, TaskConfig)),
        Section("figures", "Figures", tables.parameters_table(figures or {})),
    ]
    lead = "".join(_robot(place, *item) for place, item in enumerate(runs.items()))
    text = page(title, sections.subtitle(everything), lead, scene, parts)
    write_text(out, text)


def _together(runs: list[RecordedRun]) -> RecordedRun:
    """One run with the decisions and ways of all, one robot after the other."""
    records: list[Record] = [runs[0].start]
    for run in runs:
        records += [record for record in run.records if not isinstance(record, Start)]
    return RecordedRun(tuple(records), tuple(text for run in runs for text in run.problems))


def _robot(place: int, name: str, run: RecordedRun) -> str:
    """How a robot's exploration went, in one line of figures."""
    progress = run.of(Progress)
    looks = sum(motion.action == "look" and not motion.outcome for motion in run.of(Motion))
    tiles = [("views", str(max(looks, progress[-1].views if progress else 0)))]
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
    axes: dict[str, Callable[[Progress], float]] = {
        "its views": lambda record: float(record.views),
        "distance driven [m]": lambda record: record.distance,
        "time [s]": lambda record: record.time,
    }
    goals = [run.start.task.get("known_fraction") for run in runs.values()]
    goal = next((100.0 * float(each) for each in goals if isinstance(each, int | float)), None)
    charts = []
    for label, x_of in axes.items():
        curves = []
        for name, run in runs.items():
            progress = run.of(Progress)
            share = [100.0 * record.known_fraction for record in progress]
            xs = [x_of(record) for record in progress]
            curves.append(Curve("known", "%", xs, share, label, goal=goal, high=100.0, name=name))
        charts.append(line_chart(*curves))
    return f'<div class="charts">{"".join(charts)}</div>'
