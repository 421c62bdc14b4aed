"""What becomes of robots, recordings and calibrations that nobody here made.

Each URDF of the folders is read by `infomap robot`, each bag (or folder of a bag) by `infomap map`,
each file that looks like a camera's calibration as `--calibration` reads it.
One JSON file each in the output folder, so that a series goes on where it was broken off; table.md
says for each what came of it, and in which words. Each FOLDER holds one folder per source, such as
`owner+repository`.

    python benchmarks/public_files.py FOLDER... --out out/public_files
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rows import markdown_table, software

from infomap_ros.errors import InfomapError
from infomap_ros.geometry.atomic_file import write_json, write_text
from infomap_ros.replay.sequences.calibration_files import read_calibration

BAGS = {".mcap", ".bag", ".db3"}
CALIBRATIONS = {".yaml", ".yml", ".txt", ".xml"}
_LOOK_OF_CALIBRATION = re.compile(
    r"camera_matrix|camera_model|^P0: |Camera1?\.fx|LEFT\.K|cam0:|^M1:|<M1 |projection_parameters",
    re.MULTILINE,
)
_SIZE = 640, 480  # of images, for formats that do not say [px]
_TIMEOUT = 600.0  # [s]
_LARGEST = 100_000  # calibration [bytes]
_LONGEST = 160  # characters of a reason
_KINDS = "robot", "bag", "calibration"


def found_in(folders: list[Path]) -> Iterator[tuple[Path, Path]]:
    """URDFs, bags and calibrations, each with its folder; a rosbag2 is the folder of its files."""
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            if path.suffix in BAGS and (path.parent / "metadata.yaml").is_file():
                yield path.parent, folder
            elif path.suffix in {".urdf", *BAGS} or _looks_like_calibration(path):
                yield path, folder


def _looks_like_calibration(path: Path) -> bool:
    if path.suffix not in CALIBRATIONS or path.stat().st_size > _LARGEST:
        return False
    return bool(_LOOK_OF_CALIBRATION.search(path.read_text("utf-8", errors="replace")))


def tried(path: Path, folder: Path, work: Path) -> dict[str, Any]:
    """The figures of one file of a folder."""
    source, *inside = path.relative_to(folder).parts
    begun = time.monotonic()
    if path.suffix in CALIBRATIONS:
        kind, (status, said, crashed) = "calibration", _calibration(path)
    else:
        kind = "robot" if path.suffix == ".urdf" else "bag"
        work = work / ("robot.yaml" if kind == "robot" else "map")
        command = [kind if kind == "robot" else "map", str(path), "--out", str(work), "--overwrite"]
        status, said, crashed = _command(command)
    return {
        "software": software(),
        "source": source.replace("+", "/"),
        "kind": kind,
        "file": "/".join(inside),
        "status": status,
        "crashed": crashed,
        "said": [
            line.strip().replace(f"{path.parent}/", "")
            for line in said.splitlines()
            if line.strip()
        ],
        "seconds": time.monotonic() - begun,
    }


def _calibration(path: Path) -> tuple[int, str, bool]:
    """Status, what is said, and whether it crashed."""
    try:
        found = read_calibration([path], _SIZE)
    except InfomapError as error:
        return 1, str(error), False
    except Exception as error:  # that it has none is what is to be found out
        return 1, repr(error), True
    return 0, f"cameras: {len(found.cameras)}", False


def _command(arguments: list[str]) -> tuple[int, str, bool]:
    """Status of a command of infomap, what it says, and whether it crashed."""
    program = [sys.executable, "-m", "infomap_ros.cli", *arguments]
    try:
        run = subprocess.run(program, capture_output=True, text=True, timeout=_TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        return -1, f"not done after {_TIMEOUT:.0f} s", False
    said = run.stderr if run.returncode else run.stdout
    return run.returncode, said, "Traceback" in said


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    guessed = [line.partition(":")[0] for line in row["said"] if line.startswith("robot.")]
    cameras = [line for line in row["said"] if line.startswith("cameras:")]
    result = "guessed: " + ", ".join(guessed) if guessed else "".join(cameras) or "as it is"
    if row["status"]:
        text = " ".join(row["said"][-1:])
        result = text[:_LONGEST] + ("…" if len(text) > _LONGEST else "")
    read = "read" if not row["status"] else "refused"
    return row["source"], row["kind"], row["file"], read, result


def _summary(rows: list[dict[str, Any]]) -> str:
    """Of each source and kind: how many were read, and which were not."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["kind"], row["source"]), []).append(row)
    cells = []
    for (kind, source), own in groups.items():
        missed = [row["file"].rpartition("/")[2] for row in own if row["status"]]
        share = f"{len(own) - len(missed)} of {len(own)}"
        cells.append((kind, source, share, ", ".join(dict.fromkeys(missed))))
    return markdown_table(("kind", "source", "read", "refused"), cells)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/public_files"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for path, folder in dict.fromkeys(found_in(options.folders)):
        name = hashlib.sha256(str(path).encode()).hexdigest()[:16]
        file = options.out / f"{name}.json"
        if not file.is_file():
            write_json(file, tried(path, folder, options.out))
        rows.append(json.loads(file.read_text(encoding="utf-8")))
        print(f"{rows[-1]['file']}: {rows[-1]['status']}", file=sys.stderr)
    rows.sort(key=lambda row: (_KINDS.index(row["kind"]), row["source"].lower(), row["file"]))
    names = ("source", "kind", "file", "result", "how")
    table = f"{_summary(rows)}\n{markdown_table(names, map(_cells, rows))}"
    versions = ", ".join(dict.fromkeys(row["software"] for row in rows))
    table += f"\n{versions}\n"
    write_text(options.out / "table.md", table)
    print(table, end="")
    return 1 if any(row["crashed"] for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
