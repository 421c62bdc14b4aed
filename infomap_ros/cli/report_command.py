"""Command ``infomap report``."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Optional

import typer

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.reports.comparison import LOG_FILE, read_folder, write_comparison
from infomap_ros.exploration.reports.report import write_report

_REPORT, _COMPARISON = "report.html", "comparison.html"


def report(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="folders of explorations, simulated or of a robot: each with exploration.jsonl "
            "and, for its map, map.infomap",
            show_default=False,
        ),
    ],
    out: Annotated[
        Optional[Path],
        typer.Option(
            help="HTML file to write",
            show_default="report.html in the folder of the run; of several ./comparison.html",
        ),
    ] = None,
) -> None:
    """Write the report of an exploration from its log and map, or compare several on one page."""
    if len(runs) == 1:
        file = out or runs[0] / _REPORT
        _write_report(runs[0], file)
    else:
        file = out or Path(_COMPARISON)
        write_comparison(file, dict(zip(_names(runs), runs, strict=True)))
    typer.echo(file)


def _write_report(folder: Path, file: Path) -> None:
    found = read_folder(folder)
    if found.map_file is None:
        raise InvalidInputError(str(folder), "holds no map.infomap, the map of the exploration")
    where = found.run.start.world or found.run.start.robot or folder.resolve().name
    write_report(
        file, folder / LOG_FILE, found.map_file, f"Exploration: {where}", "", found.figures
    )


def _names(runs: Sequence[Path]) -> list[str]:
    """The last part of each path, with as many before it as tell the runs apart."""
    paths = [run.resolve() for run in runs]
    twice = [str(path) for path, count in Counter(paths).items() if count > 1]
    if twice:
        raise InvalidInputError("runs", f"{twice[0]} is given twice")
    for parts in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-parts:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    raise AssertionError("different paths have different names")
