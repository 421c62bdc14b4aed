"""What the choice of fiducials by eqs. (19)-(20) brings, beside plain strongest corners.

Localizes recorded drives with four choices: `corners` (the strongest of every part of the image),
`range` (certainty of the range itself, no map), `map` (certainty of the voxel in the map that the
drive has built so far, as `fiducial_localization` with `use_map`) and `map_depth` (that, and the
depth contrast of the dense cloud). Each drive is recorded in simulation, from a world seed of its
own, unless bags are given. Figures of each: absolute position error after alignment (ATE, rms),
mean error over 0.5 m, share of views in which the pose was not tracked.

Rows are kept in `--out`, so that a series that was broken off goes on. Prints one JSON line.

    python benchmarks/fiducial_choice.py --out out/fiducial_choice [--seeds 5] [--bags BAG ...]
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from trajectory_errors import trajectory_errors, truth_at

from infomap_ros.geometry.atomic_file import write_json
from infomap_ros.localization.fiducials.selection import FiducialSelectionConfig
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.localization.localizer import Localizer
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.scans.body import body_mask
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.localize_run import LocalizeOptions, LocalizeRun
from infomap_ros.simulation.recorder import RecorderConfig, record_bag
from infomap_ros.simulation.worlds.scenes import SceneConfig

TRUTH = "/ground_truth/camera_pose"
DELTA = 0.5  # of the relative error [m]
MAX_RANGE = 4.0  # of the map [m]
BY_RANGE = FiducialSelectionConfig()
CHOICES = {
    "corners": replace(BY_RANGE, certainty_weight=0.0, contrast_weight=0.0, depth_weight=0.0),
    "range": BY_RANGE,
    "map": BY_RANGE,
    "map_depth": replace(BY_RANGE, dense_range=True),
}


class MappingLocalizer:
    """A localizer that is given the map which its own poses have built, and the time it takes.

    Args:
        localizer: that locates.
    """

    def __init__(self, localizer: Localizer) -> None:
        self._localizer = localizer
        self.map = VoxelMap(VoxelMapConfig(max_range=MAX_RANGE))
        self.seconds = 0.0

    def locate(self, view: Any, prior: Any, body: Any = ()) -> LocalizedCamera:
        """As `Localizer.locate`; the dense cloud then goes into the map, without the body."""
        start = time.process_time()
        result = self._localizer.locate(view, prior, self.map, body=body)
        self.seconds += time.process_time() - start
        if result.state == "tracking" and result.T_map_camera is not None:
            cloud = view.cloud()
            points = cloud.organized_points
            on_body = body_mask(points, cloud.covariance_triangles, body)
            points = np.where(on_body[..., None], np.float32(np.nan), points)
            self.map.integrate(
                points,
                result.T_map_camera,
                cloud.covariance_triangles,
                result.covariance,
                camera=cloud.camera,
                error_correlation=cloud.error_correlation,
            )
        return result

    def keyframes(self) -> Any:
        """As `Localizer.keyframes`."""
        return self._localizer.keyframes()


class MappingRun(LocalizeRun):
    """Localizes a bag with the map at hand."""

    def _begin(self, framed: Any) -> Any:
        return MappingLocalizer(super()._begin(framed))


def figures_of(bag_path: Path, choice: str) -> dict[str, Any]:
    """Errors, loss of track and time of a drive with a choice of fiducials."""
    localizer = LocalizerConfig(selection=CHOICES[choice])
    options = LocalizeOptions(localizer=localizer)
    kind = MappingRun if choice.startswith("map") else LocalizeRun
    with BagReader(bag_path) as bag:
        run = kind(bag, options)
        run.run()
        records = [entry.record for entry in bag.records([TRUTH])]
    trajectory = run.trajectory
    stamps = trajectory.stamps.tolist()
    known, truth = truth_at(records, stamps)
    estimate = trajectory.transforms[known]
    kept = [stamp for stamp, is_known in zip(stamps, known, strict=True) if is_known]
    errors = trajectory_errors(kept, truth, estimate, DELTA)
    states = [one.state for one in run.localizations]
    row = {
        "ate_mm": round(1e3 * errors.ape, 2),
        "rpe_percent": round(errors.rpe_percent, 3),
        "not_tracked": round(1.0 - states.count("tracking") / len(states), 4),
        "views": len(states),
        "fiducials": round(float(np.mean([one.tracked for one in run.localizations])), 1),
    }
    if isinstance(run, MappingRun):
        row["ms_per_view"] = round(1e3 * run._localizer.seconds / len(states), 1)
        row["map_bytes"] = run._localizer.map.memory_bytes()
    return row


def drive(seed: int, pairs: int, out: Path) -> Path:
    """A recorded drive through a world of this seed."""
    path = out / f"drive_{seed}"
    if not path.exists():
        record_bag(path, RecorderConfig(pairs=pairs, seed=seed, scene=SceneConfig(seed=seed)))
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of drives and rows")
    parser.add_argument("--seeds", type=int, default=5, help="drives that are recorded")
    parser.add_argument("--pairs", type=int, default=RecorderConfig.pairs, help="of a drive")
    parser.add_argument("--bags", type=Path, nargs="*", default=[], help="in place of drives")
    parser.add_argument("--choices", nargs="*", default=list(CHOICES), choices=list(CHOICES))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    bags = given.bags or [drive(n, given.pairs, given.out) for n in range(1, given.seeds + 1)]
    rows: dict[str, dict[str, Any]] = {}
    for bag in bags:
        for choice in given.choices:
            kept = given.out / f"{bag.name}_{choice}.json"
            if not kept.is_file():
                write_json(kept, figures_of(bag, choice))
            rows[f"{bag.name} {choice}"] = json.loads(kept.read_text(encoding="utf-8"))
    means = {}
    for choice in given.choices:
        of = [row for name, row in rows.items() if name.split()[-1] == choice]
        names = ("ate_mm", "rpe_percent", "not_tracked")
        means[choice] = {
            name: round(float(np.mean([row[name] for row in of])), 4) for name in names
        }
    print(json.dumps({"drives": len(bags), "mean": means, "rows": rows}))


if __name__ == "__main__":
    main()
