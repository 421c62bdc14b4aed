"""Explores ten worlds with the rover and an office with six other robots, and judges each run.

Each run is `infomap explore` in a process of its own, localized by its own images, and compared
with the truth (docs/results/exploration_worlds.md says what the figures mean). One JSON line per
run, then a table, also in table.md of the output folder, and what fell short; the exit status is 1
where anything did. A run leaves row.json in its folder and is not run again with the same settings
unless it broke, so that a series can be broken off and go on. Worlds take minutes each.

    python benchmarks/explore_gate.py                           # all of them; --quick: five
    python benchmarks/explore_gate.py --only cave:2 ur5_on_base --out DIR
    python benchmarks/explore_gate.py --only mars:7             # any seed, with the usual budget
    python benchmarks/explore_gate.py --table                   # runs nothing, judges what is there
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rows import markdown_table, percent, software

from infomap_ros.exploration.records.recorded_run import RecordedRun, RunLogError, read_run
from infomap_ros.geometry.atomic_file import appending, write_json, write_text
from infomap_ros.simulation.cameras.stereo_camera import DRAWN_FAST

Row = dict[str, Any]

ROW_FILE, TABLE_FILE = "row.json", "table.md"
LOG_FILE, SUMMARY_FILE, OUTPUT_FILE = "exploration.jsonl", "summary.json", "output.txt"
INTERRUPTED = 130
CANNOT_DRIVE = "the base cannot drive"

VIEWS = {
    "mars:1": 71, "mars:2": 53, "mars:3": 63, "mars:4": 57,
    "office:1": 51, "office:2": 80, "office:3": 58,
    "cave:1": 28, "cave:2": 28, "cave:3": 30,
}  # fmt: skip
"""Views that the rover needed in each world with version 38ca7eb: its budget now."""
ROBOTS = ("tiago", "tiago_pro", "stretch", "pr2", "ur5_on_base", "panda_on_base")
QUICK = ("mars:1", "office:1", "cave:2", "ur5_on_base", "tiago")
_ROBOT_VIEWS = 40
_COMMON = (
    "task.known_fraction=0.96",
    "planner.threads=1",
    *(f"simulator.camera.{name}={value}" for name, value in DRAWN_FAST.items()),
)
_QUOTED = 200  # letters of what a broken run said last

LEAST_COVERAGE, MOST_CANNOT_DRIVE = 0.95, 0.05
LEAST_WITHIN = {2: 0.90, 3: 0.96}  # by sigmas, in each run
MEAN_WITHIN, MEAN_TOLERANCE = {1: 0.68, 2: 0.95}, 0.05  # over all runs
COLUMNS = (
    "run",
    "ended, because",
    "views",
    "distance",
    "true coverage",
    "contacts",
    "cannot drive",
    "pose error: end, rms",
    "pose NEES / 6",
    "map within 1 / 2 / 3 sigma",
    "time",
    "version",
    "falls short",
)


@dataclass(frozen=True)
class GateRun:
    """A run of the gate.

    Attributes:
        name: ``cave:2`` for the rover in a world of that seed, or the name of a robot.
        world: name of the world.
        seed: of the world.
        size: of the world [m].
        robot: name of its file; empty for the rover.
        views: budget; None for the usual one.
    """

    name: str
    world: str
    seed: int
    size: float
    robot: str = ""
    views: int | None = None

    @classmethod
    def of(cls, name: str) -> GateRun:
        """The run of a name.

        Raises:
            ValueError: it is neither a world with a seed nor one of the robots.
        """
        if name in ROBOTS:
            return cls(name, "office", 1, 7.0, name, _ROBOT_VIEWS)
        found = re.fullmatch(r"(mars|office|cave):(\d+)", name)
        if found is None:
            expected = f"mars:SEED, office:SEED, cave:SEED, {', '.join(ROBOTS)}"
            raise ValueError(f"'{name}' is none of {expected}")
        return cls(name, found[1], int(found[2]), 5.5, views=VIEWS.get(name))

    @property
    def most_views(self) -> int | None:
        """With which it must do; None where nothing is said of that."""
        return VIEWS.get(self.name)

    @property
    def settings(self) -> list[str]:
        """As `infomap explore` takes them after ``--set``."""
        world = [f"world.name={self.world}", f"world.seed={self.seed}", f"world.size={self.size}"]
        budget = [] if self.views is None else [f"task.max_views={self.views}"]
        return [*world, *budget, *_COMMON]

    def folder(self, out: Path) -> Path:
        """Where its results are, below that of all."""
        return out / self.name.replace(":", "_")


class Children:
    """Runs commands, each in a process, until all are ended together."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen[bytes]] = set()
        self._ended = False

    def run(self, command: Sequence[str], output: Path, timeout: float) -> str:
        """Run a command.

        Args:
            command: with its arguments.
            output: file for what it prints.
            timeout: after which it is killed [s].

        Returns:
            Why it failed; empty where it did not.
        """
        output.unlink(missing_ok=True)
        with appending(output) as file:
            with self._lock:
                if self._ended:
                    return "not begun"
                child = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,  # Ctrl-C ends it by this program only
                )
                self._running.add(child)
            try:
                status = child.wait(timeout)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
                return f"took longer than {timeout / 60.0:g} min"
            finally:
                with self._lock:
                    self._running.discard(child)
        return _why(status, output) if status else ""

    def end(self) -> None:
        """Kill those that run, and let none begin."""
        with self._lock:
            self._ended = True
            for child in self._running:
                child.kill()


def _why(status: int, output: Path) -> str:
    """Why a command failed, by its status and the last line that it printed."""
    lines = output.read_text(encoding="utf-8", errors="replace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")
    how = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
    return f"{how}: {last[:_QUOTED]}"


def kept(run: GateRun, out: Path, settings: Sequence[str]) -> Row | None:
    """The row of a run that came to its end with the same settings; None where there is none."""
    row = stored(run, out)
    as_now = row is not None and row["settings"] == [*run.settings, *settings]
    return row if row is not None and as_now and not row["problem"] else None


def stored(run: GateRun, out: Path) -> Row | None:
    """The row of a run as it is there, whatever came of it; None where there is none."""
    try:
        text = (run.folder(out) / ROW_FILE).read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    row: Row = json.loads(text)
    return row


def kept_or_new(
    run: GateRun, out: Path, settings: Sequence[str], children: Children, timeout: float
) -> Row:
    """The row of a run that was made before, else that of making it now."""
    row = kept(run, out, settings)
    if row is None:
        row = explore(run, out, settings, children, timeout)
        write_json(run.folder(out) / ROW_FILE, row)
    return row


def explore(
    run: GateRun, out: Path, settings: Sequence[str], children: Children, timeout: float
) -> Row:
    """Explore; the figures of the run, as far as it came."""
    folder = run.folder(out)
    folder.mkdir(parents=True, exist_ok=True)
    for old in (ROW_FILE, SUMMARY_FILE, LOG_FILE):
        (folder / old).unlink(missing_ok=True)
    given = [*run.settings, *settings]
    command = [sys.executable, "-m", "infomap_ros.cli", "explore", "--overwrite"]
    command += ["--out", str(folder), *(["--robot", run.robot] if run.robot else [])]
    command += [part for setting in given for part in ("--set", setting)]
    row: Row = {"run": run.name, "software": software(), "settings": given}
    row["date"] = datetime.date.today().isoformat()
    begin = time.monotonic()
    problem = children.run(command, folder / OUTPUT_FILE, timeout)
    row["wall_seconds"] = round(time.monotonic() - begin, 1)
    try:
        row |= json.loads((folder / SUMMARY_FILE).read_text(encoding="utf-8"))
        row["cannot_drive"] = cannot_drive_share(read_run(folder / LOG_FILE))
    except (OSError, ValueError, RunLogError) as error:
        problem = problem or f"left no results: {error}"
    return row | {"problem": problem}


def cannot_drive_share(run: RecordedRun) -> float | None:
    """Share of the candidates of all decisions that were refused as the base cannot drive.

    None where there was no candidate. The reason may follow another, on the ground below a view.
    """
    decisions = [step.decision for step in run.steps]
    considered = sum(decision.considered for decision in decisions)
    lost = sum(
        count
        for decision in decisions
        for reason, count in decision.rejections.items()
        if CANNOT_DRIVE in reason
    )
    return lost / considered if considered else None


def shortcomings(row: Row, most_views: int | None) -> list[str]:
    """What a run falls short in, each in some words.

    Args:
        row: of the run.
        most_views: that it may take; None for any number.
    """
    found = [row["problem"]] if row["problem"] else []
    if "true_coverage" not in row:
        return found or ["no figures"]
    coverage, lost = _number(row["true_coverage"]), _number(row.get("cannot_drive"))
    if not coverage >= LEAST_COVERAGE:
        found.append(f"true coverage {coverage:.1%} < {LEAST_COVERAGE:.0%}")
    if not row["distance"] > 0.0:
        found.append("did not drive")
    if row["contacts"] != 0:
        found.append(f"{row['contacts']} contacts")
    if not lost < MOST_CANNOT_DRIVE:
        found.append(f"cannot drive: {lost:.1%} of candidates >= {MOST_CANNOT_DRIVE:.0%}")
    if most_views is not None and row["views"] > most_views:
        found.append(f"{row['views']} views > {most_views}")
    for sigmas, least in LEAST_WITHIN.items():
        share = _number(row[f"within_{sigmas}_sigma"])
        if not share >= least:
            found.append(f"within {sigmas} sigma {share:.1%} < {least:.0%}")
    return found


def mean_shortcomings(rows: Iterable[Row]) -> list[str]:
    """What all runs together fall short in: the means of those that came to their end."""
    ended = [row for row in rows if not row["problem"] and "within_1_sigma" in row]
    if not ended:
        return ["no run came to its end"]
    found = []
    for sigmas, expected in MEAN_WITHIN.items():
        mean = sum(_number(row[f"within_{sigmas}_sigma"]) for row in ended) / len(ended)
        if not abs(mean - expected) <= MEAN_TOLERANCE:
            found.append(
                f"mean within {sigmas} sigma {mean:.1%} is more than "
                f"{100.0 * MEAN_TOLERANCE:.0f} points from {expected:.0%}"
            )
    return found


def _number(value: float | None) -> float:
    """NaN, which passes no comparison, for None."""
    return math.nan if value is None else value


def table(rows: Iterable[Row]) -> str:
    """A Markdown table with one row per run."""
    return markdown_table(COLUMNS, map(_cells, rows))


def _cells(row: Row) -> list[str]:
    short = "; ".join(shortcomings(row, VIEWS.get(row["run"]))) or "-"
    begin, end = [row["run"].replace(":", " ")], [f"{row['software']}, {row['date']}", short]
    time_taken = f"{row['wall_seconds']:.0f} s"
    if "true_coverage" not in row:
        return [*begin, "broke", *["-"] * (len(COLUMNS) - 5), time_taken, *end]
    nees = row["pose_nees"]
    within = " / ".join(percent(row[f"within_{sigmas}_sigma"], 0) for sigmas in (1, 2, 3))
    errors = [_number(row.get(f"pose_error_{which}")) for which in ("end", "rms")]
    return [
        *begin,
        f"{row['end']}: {row['detail']}".removesuffix(": "),
        str(row["views"]),
        f"{row['distance']:.1f} m",
        f"{percent(row['true_coverage'])} %",
        str(row["contacts"]),
        f"{percent(row.get('cannot_drive'))} %",
        ", ".join(f"{1e3 * error:.0f} mm" for error in errors),
        "-" if nees is None else f"{nees:.2f}",
        f"{within} %",
        time_taken,
        *end,
    ]


def closing_lines(rows: Sequence[Row]) -> list[str]:
    """What fell short in each run and in all, one line each; empty where nothing did."""
    lines = []
    for row in rows:
        found = shortcomings(row, VIEWS.get(row["run"]))
        lines += [f"{row['run']}: {shortcoming}" for shortcoming in found]
    return lines + [f"all runs: {shortcoming}" for shortcoming in mean_shortcomings(rows)]


def make_runs(
    runs: Sequence[GateRun], out: Path, settings: Sequence[str], jobs: int, timeout: float
) -> list[Row]:
    """Make all runs, some at once; prints each as it ends, and keeps the table up to date."""
    children, pool, rows = Children(), ThreadPoolExecutor(jobs), {}
    try:
        tasks = {
            pool.submit(kept_or_new, run, out, settings, children, timeout): run for run in runs
        }
        for task in as_completed(tasks):
            row = task.result()
            rows[tasks[task].name] = row
            short = shortcomings(row, tasks[task].most_views)
            print(json.dumps(row | {"falls_short": short}), flush=True)
            done = [rows[run.name] for run in runs if run.name in rows]
            write_text(out / TABLE_FILE, table(done))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        children.end()
    return [rows[run.name] for run in runs]


def report(rows: Sequence[Row], out: Path) -> int:
    """Print the table and what fell short; returns the exit status."""
    text, lines = table(rows), closing_lines(rows)
    write_text(out / TABLE_FILE, text)
    print(text)
    versions = sorted({row["software"] for row in rows})
    if versions and versions != [software()]:
        print(f"Rows were kept from {', '.join(versions)}; another --out makes them anew.")
    print("\n".join(lines) if lines else f"all {len(rows)} runs are good enough")
    return 1 if lines else 0


def main() -> int:
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends the children too
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help=f"only {' '.join(QUICK)}")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="such as cave:2 or ur5_on_base")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, default=Path("out/explore-gate"))
    parser.add_argument("--table", action="store_true", help="run nothing, judge what is there")
    parser.add_argument("--timeout", type=float, default=40.0, help="of a run [min]")
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    names = options.only or (QUICK if options.quick else (*VIEWS, *ROBOTS))
    try:
        runs = [GateRun.of(name) for name in dict.fromkeys(names)]
    except ValueError as error:
        parser.error(str(error))
    options.out.mkdir(parents=True, exist_ok=True)
    if options.table:
        found = [stored(run, options.out) for run in runs]
        return report([row for row in found if row is not None], options.out)
    try:
        rows = make_runs(runs, options.out, options.settings, options.jobs, 60.0 * options.timeout)
    except KeyboardInterrupt:
        print("interrupted; the same command goes on where it was", file=sys.stderr)
        return INTERRUPTED
    return report(rows, options.out)


if __name__ == "__main__":
    sys.exit(main())
