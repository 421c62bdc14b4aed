"""The report of an exploration or of a map: one HTML file that needs nothing beside it."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.records.recorded_run import RecordedRun, read_run
from infomap_ros.exploration.records.run_log import Decision, Message, Motion, Start
from infomap_ros.exploration.reports.report_page import sections
from infomap_ros.exploration.reports.report_page.charts import MINUS, duration, percent
from infomap_ros.exploration.reports.report_page.plan import plan
from infomap_ros.exploration.reports.report_page.scene import (
    add_camera_path,
    drawn_surface,
    scene_of,
)
from infomap_ros.exploration.reports.report_page.sections import Section, page
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import MapImage, map_from_above

CHOOSE, ARM, DRIVE, LOOK = "choose", "arm", "drive", "look"
ACTIVITIES = (CHOOSE, ARM, DRIVE, LOOK)
"""Kinds of activities; to choose includes to wait until what was seen is in the map."""

_OF_MOTIONS = {"look": LOOK, "last look": LOOK, "arm": ARM}


@dataclass(frozen=True)
class Activity:
    """A stretch of a run.

    Attributes:
        kind: one of `ACTIVITIES`.
        step: number of the decision that it belongs to, from 0; None before the first.
        begin: since the start of the run [s].
        end: likewise [s].
        clock_begin: of the robot [s]; NaN where the log does not tell.
        clock_end: likewise [s].
        problem: why it failed; empty where it did not.
    """

    kind: str
    step: int | None
    begin: float
    end: float
    clock_begin: float
    clock_end: float
    problem: str = ""

    @property
    def seconds(self) -> float:
        """How long it took [s]."""
        return max(0.0, self.end - self.begin)

    @property
    def clock_seconds(self) -> float:
        """How long it took by the robot's clock [s]; NaN where the log does not tell."""
        return max(self.clock_end - self.clock_begin, 0.0)


def activities(run: RecordedRun) -> list[Activity]:
    """Everything that the robot did, in its order, without gaps but where a run was continued.

    The log tells when a choice was made and when a motion ended; each has lasted since the one
    before.
    """
    found: list[Activity] = []
    step: int | None = None
    before: Start | Decision | Motion = run.of(Start)[0]
    for record in run.records:
        if isinstance(record, Decision):
            kind, problem, step = CHOOSE, "", 0 if step is None else step + 1
        elif isinstance(record, Motion):
            kind, problem = _OF_MOTIONS.get(record.action, DRIVE), record.outcome
        elif isinstance(record, Start):
            before = record
            continue
        else:
            continue
        times = before.time, record.time, before.clock, record.clock
        found.append(Activity(kind, step, *times, problem))
        before = record
    return found


_WORDS = {
    "choose": "choosing",
    "arm": "moving the arm",
    "drive": "driving",
    "look": "looking",
}
_ALIKE = 0.02  # clocks that differ by less than this share are shown as one
_Seconds = Callable[[Activity], float]


def time_line(run: RecordedRun) -> str:
    """Bars of what the robot did one after the other, and a table of sums.

    Args:
        run: whose log tells when each choice was made and when each motion ended.

    Returns:
        HTML; empty where the log tells of no time.
    """
    done = activities(run)
    wall = sum(each.seconds for each in done)
    if not wall > 0.0:
        return ""
    clocks: list[tuple[str, _Seconds]] = [("time", lambda each: each.seconds)]
    robot = sum(each.clock_seconds for each in done)
    if math.isfinite(robot) and robot > 0.0 and abs(robot - wall) > _ALIKE * wall:
        name = "simulated time" if run.start.world else "robot's time"
        clocks = [("wall time", clocks[0][1]), (name, lambda each: each.clock_seconds)]
    bars = "".join(_bar(name, seconds, done) for name, seconds in clocks)
    return f'<div class="timeline">{bars}</div>{_table(clocks, done)}'


def _bar(name: str, seconds: _Seconds, done: Sequence[Activity]) -> str:
    total = duration(sum(map(seconds, done)))
    parts = "".join(_part(each, seconds(each)) for each in done if seconds(each) > 0.0)
    label = html.escape(f"{name}, {total}")
    return f'<p>{label}</p><div class="lane" role="img" aria-label="{label}">{parts}</div>'


def _part(each: Activity, seconds: float) -> str:
    view = "before the first view" if each.step is None else f"view {each.step + 1}"
    text = f"{view}: {_WORDS[each.kind]}, {duration(seconds)}"
    text += f" ({each.problem})" if each.problem else ""
    step = "" if each.step is None else f' data-step="{each.step}"'
    failed = " failed" if each.problem else ""
    return (
        f'<i class="{each.kind}{failed}"{step} style="flex-grow:{seconds:.4g}" '
        f'title="{html.escape(text)}"></i>'
    )


def _table(clocks: Sequence[tuple[str, _Seconds]], done: Sequence[Activity]) -> str:
    heads = "".join(f'<th class="number">{html.escape(name)}</th>' for name, _ in clocks)
    rows = "".join(_row(kind, clocks, done) for kind in ACTIVITIES)
    return f"<table><thead><tr><th></th>{heads}</tr></thead><tbody>{rows}</tbody></table>"


def _row(kind: str, clocks: Sequence[tuple[str, _Seconds]], done: Sequence[Activity]) -> str:
    cells = ""
    for _, seconds in clocks:
        spent = sum(seconds(each) for each in done if each.kind == kind)
        share = spent / sum(map(seconds, done))
        cells += f'<td class="number">{duration(spent)}, {percent(share)}</td>'
    return f'<tr><td><i class="activity {kind}"></i>{_WORDS[kind]}</td>{cells}</tr>'


Pictures = Sequence[tuple[Path, str]]
"""PNG files with their captions."""

_KEYS = (
    '<li><i class="key base"></i>path of the base</li>'
    '<li><i class="key camera"></i>path of the camera</li>'
    '<li><i class="key dot view"></i>chosen view, with its number; the wedge shows where the '
    "camera looks; a click shows the view in 3-D and its terms</li>"
    '<li><i class="key dot rejected"></i>chosen, but the robot did not look from there</li>'
)


def write_report(
    out: str | Path,
    log_path: str | Path,
    voxel_map: VoxelMap | str | Path,
    title: str = "Exploration",
    introduction: str = "",
    figures: Mapping[str, object] | None = None,
    pictures: Pictures = (),
) -> RecordedRun:
    """Write the report of an exploration.

    Args:
        out: the HTML file.
        log_path: the run log; lines that cannot be used are named in the report.
        voxel_map: the map that the run made, or its file.
        title: heading of the page.
        introduction: a paragraph before everything else.
        figures: more figures of the run, name -> value.
        pictures: become part of the page.

    Returns:
        The run as it was read; its ``problems`` name the lines that could not be used.

    Raises:
        RunLogError: the log is not a run log; names the line and the reason.
        MapFileError: the map file cannot be used.
        OSError: a picture cannot be read or the report not written.
    """
    run = read_run(log_path)
    opened = _opened(voxel_map)
    above = _above(opened)
    lead = _paragraph(introduction) + sections.outcome(run) + sections.problems(run)
    scene = scene_of(drawn_surface(opened), above.cut if above else None, run)
    parts = [
        Section("progress", "Coverage, entropy and resolution", sections.curves(run)),
        Section("time", "What the time went into", time_line(run)),
        Section("plan", "The run from above", _plan(above, run)),
        Section("views", "Chosen views", sections.views_table(run)),
        Section("rejected", "What was rejected, and why", sections.rejections_table(run)),
        *_details(run, figures or {}),
        Section("pictures", "Pictures", sections.pictures(pictures)),
    ]
    lead += sections.run_tiles(run)
    write_text(out, page(title, sections.subtitle(run), lead, scene, parts))
    return run


def write_map_report(
    out: str | Path,
    voxel_map: VoxelMap | str | Path,
    title: str,
    introduction: str = "",
    figures: Mapping[str, object] | None = None,
    pictures: Pictures = (),
    camera_path: FloatArray | None = None,
) -> None:
    """Write the report of a map alone: no run, else as `write_report`.

    Args:
        out: the HTML file.
        voxel_map: the map, or its file.
        title: heading of the page.
        introduction: a paragraph before everything else.
        figures: name -> value.
        pictures: become part of the page.
        camera_path: positions of the camera in their order, shape (N, 3) [m]; drawn where given.

    Raises:
        MapFileError: the map file cannot be used.
        OSError: a picture cannot be read or the report not written.
    """
    opened = _opened(voxel_map)
    above = _above(opened)
    scene = scene_of(drawn_surface(opened), above.cut if above else None, None)
    if camera_path is not None and len(camera_path) > 1:
        add_camera_path(scene, camera_path)
    parts = [
        Section("plan", "The map from above", _plan(above, None, camera_path)),
        Section("figures", "Figures", sections.parameters_table(figures or {})),
        Section("pictures", "Pictures", sections.pictures(pictures)),
    ]
    lead = _paragraph(introduction) + sections.map_tiles(opened)
    write_text(out, page(title, "", lead, scene, parts))


def _details(run: RecordedRun, figures: Mapping[str, object]) -> list[Section]:
    end = run.end
    said = () if end is None else (end.reason, end.detail)
    figures = {name: value for name, value in figures.items() if value not in said}
    sides = [
        ("Task", sections.parameters_table(run.start.task, TaskConfig)),
        ("Computing time of the decisions", sections.stages_table(run)),
        ("Figures", sections.parameters_table(figures)),
    ]
    columns = "".join(f"<div><h3>{name}</h3>{body}</div>" for name, body in sides if body)
    messages = sections.messages_table(run.of(Message))
    return [
        Section("messages", "Messages", messages),
        Section("details", "Task and figures", f'<div class="columns">{columns}</div>'),
    ]


def _plan(
    above: MapImage | None, run: RecordedRun | None, camera_path: FloatArray | None = None
) -> str:
    if above is None:
        return "<p>The map has no surface.</p>"
    low, high = above.heights
    note = f"height from {low:.2f} to {high:.2f} m"
    note += f"; what lies above {above.cut:.2f} m is left out" if above.cut is not None else ""
    keys = _KEYS if run is not None else ""
    keys += f'<li><i class="key ramp"></i>{note.replace("-", MINUS)}</li>'
    if camera_path is not None:
        keys += '<li><i class="key camera"></i>path of the camera</li>'
    drawn = plan(above, *(() if run is None else (run,)), camera_path=camera_path)
    return f'<div class="above">{drawn}<ul class="keys">{keys}</ul></div>'


def _above(voxel_map: VoxelMap) -> MapImage | None:
    try:
        return map_from_above(voxel_map)
    except InvalidInputError:  # no surface yet
        return None


def _opened(voxel_map: VoxelMap | str | Path) -> VoxelMap:
    return voxel_map if isinstance(voxel_map, VoxelMap) else VoxelMap.load(voxel_map)


def _paragraph(text: str) -> str:
    return f"<p>{html.escape(text)}</p>" if text else ""
