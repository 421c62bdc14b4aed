"""Tables of the page: chosen views, what was rejected and why, times, messages, parameters."""

from __future__ import annotations

import html
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from infomap_ros.exploration.records.log_records import Decision, Message
from infomap_ros.exploration.records.recorded_run import RUN_ENDED, RecordedRun, Step
from infomap_ros.exploration.reports.report_page.axes import DASH, MINUS, duration, number, quantity
from infomap_ros.exploration.reports.report_page.scene import term_names, unit_of
from infomap_ros.geometry.config import parameters_of


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
    told = {} if config is None else parameters_of(config)
    if not parameters:
        return ""
    items = parameters.items()
    rows = [[html.escape(words(n)), html.escape(with_unit(n, v, config))] for n, v in items]
    abouts = (told[name][1].description if name in told else "" for name in parameters)
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
    told = {} if config is None else parameters_of(config)
    text = as_text(value)
    if name in told:
        return f"{text}\u2009{told[name][1].unit}".rstrip() if text else DASH
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
