"""What the time of a run went into, by wall time and by the robot's clock."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence

from infomap_ros.exploration.records.activities import ACTIVITIES, Activity, activities
from infomap_ros.exploration.records.recorded_run import RecordedRun
from infomap_ros.exploration.reports.report_page.axes import duration, percent

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
