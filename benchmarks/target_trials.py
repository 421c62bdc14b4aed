"""How well targets are found: rendered boards of tags, and CAD models in noisy range maps.

    python benchmarks/target_trials.py tags --trials 25
    python benchmarks/target_trials.py model --trials 8 --data ../shared/data

The scenes are those of the tests (test/localization/tag_scenes.py, model_scenes.py). One JSON line
per row of the tables in docs/localization.md.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test"))

from localization.model_scenes import CloudView, box, bracket, knobbed_box, range_map, some_pose
from localization.tag_scenes import BoardView, pose_error, seen_from, single_tag

from infomap_ros.localization.target.config import ModelTargetConfig
from infomap_ros.localization.target.model_scene import shape_from_triangles
from infomap_ros.localization.target.model_target import ModelTargetDetector
from infomap_ros.localization.target.tag_board import TagBoard
from infomap_ros.localization.target.tag_detector import TagTargetConfig, TagTargetDetector
from infomap_ros.localization.target.target import TargetRefusal, TargetSighting

CORNER_SIGMA = 0.25  # [px] of a real sheet, added to the rendered corners
RANGE_SIGMA = 0.003  # [1/m]


class Row:
    """Counts and errors of the trials of one row."""

    def __init__(self) -> None:
        self.errors: list[np.ndarray] = []
        self.nees: list[float] = []
        self.refusals: Counter[str] = Counter()
        self.wrong = 0
        self.seconds = 0.0

    def add(self, result: TargetSighting | TargetRefusal, truth: np.ndarray | None) -> None:
        """Take one trial; without a truth every sighting is wrong."""
        if isinstance(result, TargetRefusal):
            self.refusals[result.reason] += 1
            return
        error = pose_error(result.T_camera_target, truth if truth is not None else np.eye(4))
        nees = float(error @ np.linalg.solve(result.covariance, error))
        if truth is None or nees > 100.0:
            self.wrong += 1
            return
        self.errors.append(error)
        self.nees.append(nees)

    def summary(self, trials: int) -> dict[str, object]:
        """One flat object."""
        errors = np.array(self.errors).reshape(-1, 6)
        rms = np.sqrt(np.mean(np.square(errors), axis=0)) if len(errors) else np.zeros(6)
        return {
            "trials": trials,
            "found": len(errors),
            "wrong": self.wrong,
            "position_rms_mm": round(1e3 * float(np.linalg.norm(rms[:3])), 2),
            "rotation_rms_deg": round(float(np.degrees(np.linalg.norm(rms[3:]))), 3),
            "nees": round(float(np.mean(self.nees)), 1) if self.nees else None,
            "seconds": round(self.seconds / trials, 3),
            **self.refusals,
        }


def tag_rows(trials: int) -> Iterator[dict[str, object]]:
    """Boards and single tags over distance, tilt and with or without range."""
    cases = [
        ("board 2x2 of 0.16 m", TagBoard(), RANGE_SIGMA, (0.8, 1.6, 3.2)),
        ("one tag of 0.16 m", single_tag(), None, (0.6, 1.2, 2.4)),
        ("one tag of 0.16 m, with range", single_tag(), RANGE_SIGMA, (0.6, 1.2, 2.4)),
    ]
    for name, board, sigma, distances in cases:
        detector = TagTargetDetector(TagTargetConfig(board=board.config))
        for distance in distances:
            for tilt in (0.0, 0.3, 0.9):
                row, rng = Row(), np.random.default_rng(5)
                for _ in range(trials):
                    pose = seen_from(board, distance, tilt, rng)
                    view = BoardView(board, pose, rng, sigma)
                    began = time.process_time()
                    tags = detector.find(view)
                    noise = rng.normal(0.0, CORNER_SIGMA, tags.corners.shape)
                    result = detector.locate(tags._replace(corners=tags.corners + noise), view)
                    row.seconds += time.process_time() - began
                    row.add(result, pose)
                yield {"target": name, "distance": distance, "tilt": tilt, **row.summary(trials)}


def model_rows(trials: int, data: Path) -> Iterator[dict[str, object]]:
    """Asymmetric models present and absent, symmetric models present."""
    meshes = data / "meshes"
    shapes = {"bracket": (bracket(), True), "box": (box((0.22, 0.16, 0.1)), False)}
    shapes["box with a knob"] = (knobbed_box(), True)
    for name, distinct in (("PowerDrill", True), ("CrackerBox", False)):
        path = meshes / name / "textured_simple_reoriented.obj"
        if path.is_file():
            shapes[name] = (obj_triangles(path), distinct)
    for name, (triangles, distinct) in shapes.items():
        detector = ModelTargetDetector(ModelTargetConfig(), shape_from_triangles(triangles))
        for present in (True, False) if distinct else (True,):
            row, rng = Row(), np.random.default_rng(31)
            for _ in range(trials):
                pose = some_pose(rng)
                view = CloudView(range_map(triangles if present else None, pose, rng))
                began = time.process_time()
                result = detector.detect(view)
                row.seconds += time.process_time() - began
                row.add(result, pose if present and distinct else None)
            yield {"target": name, "present": present, **row.summary(trials)}


def obj_triangles(path: Path) -> np.ndarray:
    """Triangles of an .obj file, shape (F, 3, 3)."""
    lines = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([line[1:4] for line in lines if line[:1] == ["v"]], dtype=float)
    faces = [line[1:] for line in lines if line[:1] == ["f"]]
    return vertices[np.array([[int(one.split("/")[0]) - 1 for one in face] for face in faces])]


def main() -> None:
    """Print one JSON line per row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=("tags", "model"))
    parser.add_argument("--trials", type=int, default=8)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    options = parser.parse_args()
    if options.kind == "tags":
        rows = tag_rows(options.trials)
    else:
        rows = model_rows(options.trials, options.data)
    for row in rows:
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
