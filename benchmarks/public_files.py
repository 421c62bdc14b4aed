"""What becomes of robots, recordings and calibrations that nobody here made.

Each URDF of the folders is read by `infomap robot`, each bag (or folder of a bag) by `infomap map`,
each file that looks like a camera's calibration as `--calibration` reads it.
One JSON file each in the output folder, so that a series goes on where it was broken off; table.md
says for each what came of it, and in which words.

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

from infomap_ros.geometry.atomic_file import write_json, write_text

BAGS = {".mcap", ".bag", ".db3"}
CALIBRATIONS = {".yaml", ".yml", ".txt", ".xml"}
_LOOK_OF_CALIBRATION = re.compile(
    r"camera_matrix|camera_model|^P0: |Camera1?\.fx|LEFT\.K|cam0:|^M1:|<M1 |projection_parameters",
    re.MULTILINE,
)
_SIZE = 640, 480  # of images, for formats that do not say [px]
_READ_CALIBRATION = f"""
import sys
from pathlib import Path
from infomap_ros.errors import CalibrationError
from infomap_ros.replay.sequences.calibration_files import read_calibration
try:
    found = read_calibration([Path(sys.argv[1])], {_SIZE})
except CalibrationError as error:
    sys.exit(str(error))
print("cameras:", len(found.cameras))
"""
_TIMEOUT = 600.0  # [s]
_LARGEST = 100_000  # calibration [bytes]
_LONGEST = 160  # characters of a reason


def found_in(folders: list[Path]) -> Iterator[Path]:
    """URDFs, bags and calibrations; the folder of a bag of ROS 2 stands for its files."""
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            if path.suffix == ".urdf":
                yield path
            elif path.suffix in BAGS:
                yield path.parent if (path.parent / "metadata.yaml").is_file() else path
            elif _looks_like_calibration(path):
                yield path


def _looks_like_calibration(path: Path) -> bool:
    if path.suffix not in CALIBRATIONS or path.stat().st_size > _LARGEST:
        return False
    return bool(_LOOK_OF_CALIBRATION.search(path.read_text("utf-8", errors="replace")))


def tried(path: Path, work: Path) -> dict[str, Any]:
    """The figures of one file."""
    program = [sys.executable, "-m", "infomap_ros.cli"]
    if path.suffix == ".urdf":
        program += ["robot", str(path), "--out", str(work / "robot.yaml"), "--overwrite"]
    elif path.suffix in CALIBRATIONS:
        program = [sys.executable, "-c", _READ_CALIBRATION, str(path)]
    else:
        program += ["map", str(path), "--out", str(work / "map"), "--overwrite"]
    begun = time.monotonic()
    try:
        run = subprocess.run(program, capture_output=True, text=True, timeout=_TIMEOUT, check=False)
        status, said = run.returncode, run.stderr if run.returncode else run.stdout
    except subprocess.TimeoutExpired:
        status, said = -1, f"not done after {_TIMEOUT:.0f} s"
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    return {
        "software": software(),
        "file": f"{path.parent.name}/{path.name}",
        "status": status,
        "crashed": "Traceback" in said,
        "said": lines,
        "seconds": time.monotonic() - begun,
    }


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    guessed = [line.partition(":")[0] for line in row["said"] if line.startswith("robot.")]
    cameras = [line for line in row["said"] if line.startswith("cameras:")]
    result = "guessed: " + ", ".join(guessed) if guessed else "".join(cameras) or "as it is"
    if row["status"]:
        text = " ".join(row["said"][-1:])
        result = text[:_LONGEST] + ("…" if len(text) > _LONGEST else "")
    return row["file"], "read" if not row["status"] else "refused", result, row["software"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/public_files"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for path in dict.fromkeys(found_in(options.folders)):
        name = hashlib.sha256(str(path).encode()).hexdigest()[:16]
        file = options.out / f"{name}.json"
        if not file.is_file():
            write_json(file, tried(path, options.out))
        rows.append(json.loads(file.read_text(encoding="utf-8")))
        print(f"{rows[-1]['file']}: {rows[-1]['status']}", file=sys.stderr)
    table = markdown_table(("file", "result", "how", "version"), map(_cells, rows))
    write_text(options.out / "table.md", table)
    print(table, end="")
    return 1 if any(row["crashed"] for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
