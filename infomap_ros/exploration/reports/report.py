"""The report of an exploration or of a map: one HTML file that needs nothing beside it."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.records.log_records import Message
from infomap_ros.exploration.records.recorded_run import RecordedRun, read_run
from infomap_ros.exploration.reports.report_page import sections, tables
from infomap_ros.exploration.reports.report_page.axes import MINUS
from infomap_ros.exploration.reports.report_page.page import Section, page
from infomap_ros.exploration.reports.report_page.plan import plan
from infomap_ros.exploration.reports.report_page.scene import add_camera_path, scene_of
from infomap_ros.exploration.reports.report_page.surface import drawn_surface
from infomap_ros.exploration.reports.report_page.time_line import time_line
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import MapImage, map_from_above

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
        Section("views", "Chosen views", tables.views_table(run)),
        Section("rejected", "What was rejected, and why", tables.rejections_table(run)),
        *_details(run, figures or {}),
        Section("pictures", "Pictures", sections.pictures(pictures)),
    ]
    lead += sections.run_tiles(run)
    _write(out, page(title, sections.subtitle(run), lead, scene, parts))
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
        Section("figures", "Figures", tables.parameters_table(figures or {})),
        Section("pictures", "Pictures", sections.pictures(pictures)),
    ]
    lead = _paragraph(introduction) + sections.map_tiles(opened)
    _write(out, page(title, "", lead, scene, parts))


def _details(run: RecordedRun, figures: Mapping[str, object]) -> list[Section]:
    end = run.end
    said = () if end is None else (end.reason, end.detail)
    figures = {name: value for name, value in figures.items() if value not in said}
    sides = [
        ("Task", tables.parameters_table(run.start.task, TaskConfig)),
        ("Computing time of the decisions", tables.stages_table(run)),
        ("Figures", tables.parameters_table(figures)),
    ]
    columns = "".join(f"<div><h3>{name}</h3>{body}</div>" for name, body in sides if body)
    messages = tables.messages_table(run.of(Message))
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
    if run is not None:
        drawn = plan(above, run)
    elif camera_path is None:
        drawn = plan(above)
    else:
        keys += '<li><i class="key camera"></i>path of the camera</li>'
        drawn = plan(above, camera_path=camera_path)
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


def _write(out: str | Path, text: str) -> None:
    write_text(out, text)
