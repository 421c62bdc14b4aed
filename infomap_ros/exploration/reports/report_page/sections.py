"""The parts of the page that need no script: outcome, key figures, curves, pictures.

Tables of the page: chosen views, what was rejected and why, times, messages, parameters.
"""

from __future__ import annotations

import base64
import html
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

import infomap_ros.exploration.reports.report_page as package
from infomap_ros.exploration.records.recorded_run import RUN_ENDED, RecordedRun, Step
from infomap_ros.exploration.records.run_log import Decision, Message, Progress
from infomap_ros.exploration.reports.report_page.charts import (
    DASH,
    MINUS,
    Curve,
    duration,
    line_chart,
    number,
    percent,
    quantity,
)
from infomap_ros.exploration.reports.report_page.scene import pack, term_names, unit_of
from infomap_ros.geometry.config import parameters_of
from infomap_ros.mapping import VoxelMap

# In the order in which they build on each other.
_SCRIPTS = (
    *("basics.js", "data.js", "vectors.js", "orbit.js", "drawing.js", "layers.js"),
    *("overlay.js", "viewer.js", "panel.js", "main.js"),
)
_PLAIN_SCRIPTS = ("basics.js", "plain.js")


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes:
        name: for links to it.
        heading: its title.
        body: its HTML; a section with an empty body is left out.
    """

    name: str
    heading: str
    body: str


def page(
    title: str,
    subtitle: str,
    lead: str,
    scene: Mapping[str, Any] | None,
    sections: Sequence[Section],
) -> str:
    """Put the page together.

    Args:
        title: plain text.
        subtitle: HTML below it.
        lead: HTML before the 3-D view.
        scene: of `scene_of`; None for a page without a 3-D view.
        sections: what follows the 3-D view.
    """
    return Template(_asset("page.html")).substitute(
        title=html.escape(title),
        subtitle=subtitle,
        lead=lead,
        sections="\n".join(_section(section) for section in sections if section.body),
        style=_asset("page.css"),
        viewer="" if scene is None else _asset("viewer.html"),
        script="\n".join(map(_asset, _PLAIN_SCRIPTS if scene is None else _SCRIPTS)),
        data="" if scene is None else _scene_data(scene),
    )


def _scene_data(scene: Mapping[str, Any]) -> str:
    places, data = pack(scene["arrays"])
    manifest = json.dumps({**scene["manifest"], "arrays": places}, allow_nan=False)
    return _data("manifest", "application/json", manifest) + _data("arrays", "text/plain", data)


def _section(section: Section) -> str:
    heading = html.escape(section.heading)
    return f'<section id="{section.name}"><h2>{heading}</h2>{section.body}</section>'


def _data(name: str, kind: str, text: str) -> str:
    """Text that a script reads and that cannot end its own element."""
    return f'<script id="{name}" type="{kind}">{text.replace("<", chr(92) + "u003c")}</script>\n'


def _asset(name: str) -> str:
    return files(package).joinpath("assets", name).read_text(encoding="utf-8")


_ENDINGS = {
    "done": ("good", "Done"),
    "nothing left worth its cost": ("warn", "Nothing left that is worth its cost"),
    "budget spent": ("warn", "The budget is spent"),
    "stopped": ("warn", "Stopped"),
    "failed": ("bad", "Failed"),
}


def outcome(run: RecordedRun) -> str:
    """Why the run ended, as the page's first sentence."""
    end = run.end
    if end is None:
        kind, name, detail = "warn", "Not ended", "The log has no end."
    else:
        kind, name = _ENDINGS.get(end.reason, ("warn", end.reason))
        detail = end.detail
    return (
        f'<p class="outcome"><strong class="{kind}">{html.escape(name)}</strong> '
        f"{html.escape(detail)}</p>"
    )


def _known(name: str, length: float) -> str:
    return f"{name} {quantity(length, 'm', 2)}" if math.isfinite(length) else ""


def subtitle(run: RecordedRun) -> str:
    """Which robot explored what, and how."""
    start = run.start
    parts = [
        f"robot {start.robot}" if start.robot else "",
        f"world {start.world}" if start.world else "",
        f"strategy {start.strategy.replace('_', ' ')}" if start.strategy else "",
        _known("voxels of", start.voxel_size),
        _known("range", start.max_range),
    ]
    return html.escape(" · ".join(part for part in parts if part))


def problems(run: RecordedRun) -> str:
    """A box that names the lines of the log that could not be used."""
    if not run.problems:
        return ""
    lines = "".join(f"<li>{html.escape(text)}</li>" for text in run.problems[:20])
    more = f"<li>and {len(run.problems) - 20} more</li>" if len(run.problems) > 20 else ""
    return (
        '<div class="problems" role="note"><strong>Not all of the run log could be used.</strong>'
        f"<ul>{lines}{more}</ul></div>"
    )


def run_tiles(run: RecordedRun) -> str:
    """Key figures of a run."""
    progress = run.of(Progress)
    last = progress[-1] if progress else None
    figures = [
        ("views", str(run.views)),
        ("time", duration(run.seconds)),
    ]
    if last is not None:
        figures[1:1] = [("driven", quantity(last.distance, "m"))]
        figures += [
            ("known", percent(last.known_fraction)),
            ("precise", percent(last.precise_fraction)),
            ("entropy left", quantity(last.entropy_bits, "bit")),
            ("mean sigma", quantity(last.mean_sigma, "m")),
            ("surface voxels", f"{last.surface_voxels:,}".replace(",", "\u2009")),
        ]
    return tiles(figures)


def map_tiles(voxel_map: VoxelMap) -> str:
    """Key figures of a map."""
    counts = [
        ("surface voxels", voxel_map.surface_voxels),
        ("known voxels", voxel_map.known_voxels),
    ]
    figures = [(name, f"{count:,}".replace(",", "\u2009")) for name, count in counts]
    figures.append(("voxel size", quantity(voxel_map.config.voxel_size, "m")))
    figures.append(("memory", quantity(float(voxel_map.memory_bytes()), "B")))
    return tiles(figures)


def tiles(figures: Sequence[tuple[str, str]]) -> str:
    """Names and values side by side."""
    items = "".join(
        f"<div><dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd></div>"
        for name, value in figures
    )
    return f'<dl class="tiles">{items}</dl>'


AXES: Mapping[str, Callable[[Progress], float]] = {
    "views": lambda record: float(record.views),
    "distance driven [m]": lambda record: record.distance,
    "time [s]": lambda record: record.time,
}
"""What progress is drawn over."""
KNOWN = ("known", "%", False, lambda record: 100.0 * record.known_fraction)
VALUES: Sequence[tuple[str, str, bool, Callable[[Progress], float]]] = (
    KNOWN,
    ("known precisely", "%", False, lambda record: 100.0 * record.precise_fraction),
    ("entropy left", "bit", True, lambda record: record.entropy_bits),
    ("mean sigma", "m", True, lambda record: record.mean_sigma),
)
"""What is drawn of progress: title, unit, whether that takes an SI prefix, and the value."""


def charts(
    runs: Mapping[str, Sequence[Progress]],
    axes: Mapping[str, Callable[[Progress], float]] = AXES,
    values: Sequence[tuple[str, str, bool, Callable[[Progress], float]]] = VALUES,
    goals: Mapping[str, float | None] | None = None,
) -> str:
    """A chart of each value over each axis.

    Args:
        runs: progress of each, a curve in every chart, by its name.
        axes: of `AXES`, by label.
        values: of `VALUES`.
        goals: that the task asks for, by title.
    """
    drawn = []
    for label, x_of in axes.items():
        # Of the records at one place, as of several lines of the log at one view, the last holds.
        rows = {name: list({x_of(r): r for r in run}.values()) for name, run in runs.items()}
        if not any(x_of(r) > 0.0 for row in rows.values() for r in row):
            drawn.append(f'<p class="wide">All stay at 0: no curves over {label}.</p>')
            continue
        for title, unit, scaled, y_of in values:
            goal, high = (goals or {}).get(title), None if scaled else 100.0
            curves = []
            for name, progress in rows.items():
                xs, ys = [x_of(r) for r in progress], [y_of(r) for r in progress]
                curves.append(Curve(title, unit, xs, ys, label, scaled, goal, 0.0, high, name))
            drawn.append(line_chart(*curves))
    return "".join(drawn)


def curves(run: RecordedRun) -> str:
    """Coverage, entropy and sigma over views and over distance."""
    progress = run.of(Progress)
    if not progress:
        return "<p>The log has no progress.</p>"
    axes = {label: of for label, of in AXES.items() if label != "time [s]"}
    drawn = charts({"": progress}, axes, goals={"known precisely": goal_of(run)})
    return f'<div class="charts">{drawn}</div>'


def goal_of(run: RecordedRun) -> float | None:
    """Share of the surface that the task asks for [%]; None where the log does not tell."""
    value = run.start.task.get("known_fraction")
    return 100.0 * float(value) if isinstance(value, int | float) else None


def pictures(files: Sequence[tuple[Path, str]]) -> str:
    """PNG files with their captions, as part of the page.

    Raises:
        OSError: a file cannot be read.
    """
    figures = []
    for path, caption in files:
        content = base64.b64encode(path.read_bytes()).decode("ascii")
        text = html.escape(caption)
        figures.append(
            f'<figure><img alt="{text}" src="data:image/png;base64,{content}">'
            f"<figcaption>{text}</figcaption></figure>"
        )
    return "".join(figures)


def table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    kind: str = "",
    attributes: Sequence[str] = (),
) -> str:
    """A table of cells that are HTML already.

    Args:
        heads: of the columns; one that begins with ``#`` stands over numbers.
        rows: cells; a row of one cell spans the table.
        kind: class of the table.
        attributes: of each row's element; none where empty.
    """
    numeric = [head.startswith("#") for head in heads]
    classes = [' class="number"' if is_number else "" for is_number in numeric]
    top = "".join(
        f'<th scope="col"{kind}>{html.escape(head.lstrip("#"))}</th>'
        for head, kind in zip(heads, classes, strict=True)
    )
    body = []
    for place, row in enumerate(rows):
        if len(row) == 1:
            cells = f'<td class="whole" colspan="{len(heads)}"><div>{row[0]}</div></td>'
        else:
            cells = "".join(f"<td{c}>{cell}</td>" for c, cell in zip(classes, row, strict=True))
        body.append(f"<tr{attributes[place] if attributes else ''}>{cells}</tr>")
    return (
        f'<div class="scroll"><table class="{kind}"><thead><tr>{top}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def views_table(run: RecordedRun) -> str:
    """Chosen views with their terms and the reason; a click shows one in the 3-D view."""
    if not run.steps:
        return "<p>No view was chosen.</p>"
    every = term_names([step.decision for step in run.steps])
    names = [name for name in every if any(step.decision.terms.get(name) for step in run.steps)]
    heads = ["#view", "#time", "position [m]", "#rating"]
    heads += [*(f"#{words(n)} {unit_of(n)}".rstrip() for n in names), "#candidates", "outcome"]
    rows, marks = [], []
    for place, step in enumerate(run.steps):
        rows += [_view_row(step, names), [html.escape(step.decision.reason)]]
        marks += [f' class="step" data-step="{place}" tabindex="0"', f' data-step="{place}"']
    return table(heads, rows, "views", marks)


def _view_row(step: Step, names: Sequence[str]) -> list[str]:
    decision = step.decision
    place = DASH
    if decision.pose is not None:
        values = (f"{value:7.2f}" for value in decision.pose[:3, 3])
        place = "".join(values).replace("-", MINUS).replace(" ", _FIGURE_SPACE)
    kind = "good" if step.taken else "warn" if step.outcome == RUN_ENDED else "bad"
    possible = decision.considered - sum(decision.rejections.values())
    return [
        str(decision.view),
        duration(decision.time),
        f'<span class="place">{place}</span>',
        number(decision.rating),
        *(number(decision.terms.get(name, math.nan)) for name in names),
        f"{possible} of {decision.considered}",
        f'<span class="{kind}">{html.escape(step.outcome)}</span>',
    ]


def rejections_table(run: RecordedRun) -> str:
    """How often candidates were rejected, by reason, with an example of the details."""
    decisions = [step.decision for step in run.steps]
    counts = kinds_of_rejections(decisions)
    every = [reason for decision in decisions for reason in decision.rejections]
    examples = {kind_of(reason): reason for reason in reversed(every)}
    considered = sum(decision.considered for decision in decisions)
    if not counts:
        return f"<p>None of the {considered:,} candidates was rejected.</p>"
    largest = max(counts.values())
    rows = [
        [
            html.escape(kind),
            f'<span class="bar" style="width:{8.0 * count / largest:.2f}em"></span>{count:,}',
            f"{100.0 * count / considered:.1f} %",
            html.escape(_details_of(examples[kind])),
        ]
        for kind, count in counts.most_common()
    ]
    possible = considered - counts.total()
    text = f"<p>Of {considered:,} candidates in {len(run.steps)} decisions {possible:,} "
    text += "were possible.</p>"
    return text + table(
        ["reason", "#rejected", "#share of all", "details, for example"], rows, "rejections"
    )


def kinds_of_rejections(decisions: Sequence[Decision]) -> Counter[str]:
    """How many candidates were rejected, by reason without details."""
    counts: Counter[str] = Counter()
    for decision in decisions:
        for reason, count in decision.rejections.items():
            counts[kind_of(reason)] += count
    return counts


def kind_of(reason: str) -> str:
    """A reason without its details, which follow a colon or are numbers."""
    return re.sub(r"\d+(?:[.,]\d+)*", "N", reason.split(":")[0]).strip()


def _details_of(reason: str) -> str:
    """What `kind_of` leaves out; the whole reason where that is a number in it."""
    head, _, details = reason.partition(":")
    return details.strip() if kind_of(reason) == head.strip() else reason


def stages_table(run: RecordedRun) -> str:
    """Computing time of the decisions by stage."""
    stages: dict[str, list[float]] = {}
    for step in run.steps:
        for name, seconds in step.decision.seconds.items():
            stages.setdefault(name, []).append(seconds)
    if not stages:
        return ""
    heads = ["stage", "#median", "#longest", "#in all"]
    rows = [
        [
            html.escape(words(name)),
            quantity(float(np.nanmedian(values)), "s"),
            quantity(float(np.nanmax(values)), "s"),
            duration(float(np.nansum(values))),
        ]
        for name, values in stages.items()
        if np.isfinite(values).any()
    ]
    return table(heads, rows, "stages")


def messages_table(messages: Sequence[Message]) -> str:
    """What the run told, with the time."""
    rows = [
        [
            duration(message.time),
            f'<span class="{_LEVELS.get(message.level, "")}">{html.escape(message.level)}</span>',
            html.escape(message.text),
        ]
        for message in messages
    ]
    return table(["#time", "level", "message"], rows, "messages") if rows else ""


_FIGURE_SPACE = "\u2007"  # as wide as a digit
_LEVELS = {"warning": "warn", "error": "bad"}


def parameters_table(parameters: Mapping[str, object], config: type | None = None) -> str:
    """Names and values, with unit and meaning where they are fields of a configuration."""
    known = {} if config is None else parameters_of(config)
    if not parameters:
        return ""
    items = parameters.items()
    rows = [[html.escape(words(n)), html.escape(with_unit(n, v, config))] for n, v in items]
    abouts = (known[name][1].description if name in known else "" for name in parameters)
    marks = [f' title="{html.escape(about)}"' if about else "" for about in abouts]
    return table(["name", "#value"], rows, "parameters", marks)


_UNITS = {  # of figures whose name is so; the first that fits holds
    r"\w*(_coverage|_fraction)|within_\d_sigma": "%",
    r"(\w+_)?seconds(_\w+)?": "s",
    r"\w+_turn_\w+": "rad",
    r"(\w+_)?(distance|length|range|size|sigma|error)(_\w+)?": "m",
    r"\w+_bytes": "B",
}


def with_unit(name: str, value: object, config: type | None = None) -> str:
    """A value as text: of a field of a configuration with its unit, else of a figure of a run."""
    if isinstance(value, list) and config is None:
        return ", ".join(with_unit(name, each) for each in value) or DASH
    known = {} if config is None else parameters_of(config)
    text = as_text(value)
    if name in known:
        return f"{text}\u2009{known[name][1].unit}".rstrip() if text else DASH
    unit = next((unit for names, unit in _UNITS.items() if re.fullmatch(names, name)), "")
    if not unit or not isinstance(value, int | float):
        return text or DASH
    return f"{number(100.0 * value)}\u2009%" if unit == "%" else quantity(float(value), unit, 4)


def words(name: str) -> str:
    """A name of the program as words."""
    return name.replace("_", " ")


def as_text(value: object) -> str:
    """A value of any kind as text."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: DASH}[value]
    if isinstance(value, int | float):
        return number(float(value), 4)
    if isinstance(value, Mapping):
        return ", ".join(f"{words(str(key))} {as_text(item)}" for key, item in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(as_text(item) for item in value)
    return str(value)
