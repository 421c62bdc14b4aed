"""The parts of the page that need no script: outcome, key figures, curves, pictures."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from infomap_ros.exploration.records.log_records import Motion, Progress
from infomap_ros.exploration.records.recorded_run import RecordedRun
from infomap_ros.exploration.reports.report_page.axes import duration, percent, quantity
from infomap_ros.exploration.reports.report_page.charts import Curve, line_chart
from infomap_ros.mapping import VoxelMap

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
        kind, name, detail = "warn", "Not ended", "The log does not tell an end."
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
    taken = sum(motion.action == "look" and not motion.outcome for motion in run.of(Motion))
    figures = [
        ("views", str(max(taken, last.views if last else 0))),
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


def curves(run: RecordedRun) -> str:
    """Coverage, entropy and sigma over views and over distance."""
    progress = run.of(Progress)
    if not progress:
        return "<p>The log tells no progress.</p>"
    task = run.start.task
    by_view = list({record.views: record for record in progress}.values())
    charts = _curves(by_view, [r.views for r in by_view], "views", task)
    note = ""
    if any(record.distance > 0.0 for record in progress):
        charts += _curves(progress, [r.distance for r in progress], "distance driven [m]", task)
    else:
        note = "<p>The base did not drive, so there are no curves over distance.</p>"
    return f'<div class="charts">{"".join(charts)}</div>{note}'


def _curves(
    progress: Sequence[Progress], xs: Sequence[float], label: str, task: Mapping[str, object]
) -> list[str]:
    wanted = _goal(task, "known_fraction")
    share = [100.0 * record.known_fraction for record in progress]
    precise = [100.0 * record.precise_fraction for record in progress]
    bits = [record.entropy_bits for record in progress]
    sigmas = [record.mean_sigma for record in progress]
    goal = None if wanted is None else 100.0 * wanted
    return [
        line_chart(Curve("known", "%", xs, share, label, high=100.0)),
        line_chart(Curve("known precisely", "%", xs, precise, label, goal=goal, high=100.0)),
        line_chart(Curve("entropy left", "bit", xs, bits, label, scaled=True)),
        line_chart(Curve("mean sigma", "m", xs, sigmas, label, scaled=True)),
    ]


def _goal(task: Mapping[str, object], name: str) -> float | None:
    value = task.get(name)
    return float(value) if isinstance(value, int | float) else None


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
