"""What predicting the localization error costs a choice among views, beside odometry drift.

The hall of `bench_decision.py`, 10 m, 1,000 candidates. Processor time; the median of the repeats.
Prints one JSON line.

    python benchmarks/bench_localization_error.py [--fiducials 300] [--repeats 5]
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from bench_decision import RIG, decide, hall, rover, seen

from infomap_ros.exploration.fiducial_error import FiducialLocalizationError
from infomap_ros.localization.filter.config import Fiducials
from infomap_ros.views.next_best_view import NextBestView
from infomap_ros.views.situation import Situation

SIDE = 10.0


class TimedError(FiducialLocalizationError):
    """Adds up the processor time of its calls."""

    spent = 0.0

    def __call__(self, situation: Situation, poses: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """As the base class."""
        start = time.process_time()
        result = super().__call__(situation, poses, lengths)
        self.spent += time.process_time() - start
        return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--fiducials", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    voxel_map, robot = seen(hall(SIDE), SIDE), rover()
    _, means, _ = voxel_map.gaussians()
    near = means[np.linalg.norm(means - (0.0, 0.0, 0.8), axis=1) < 0.5 * SIDE]
    points = near[np.random.default_rng(0).choice(len(near), options.fiducials, replace=False)]
    covariances = np.tile(4e-4 * np.eye(3), (len(points), 1, 1))
    known = Fiducials(np.arange(len(points)), points, covariances)
    error = TimedError(RIG, lambda: known)
    choosers = {"drift": NextBestView(), "fiducials": NextBestView(localization_error=error)}
    times: dict[str, list[float]] = {name: [] for name in (*choosers, "prediction")}
    for repeat in range(options.repeats + 1):
        for name, chooser in choosers.items():
            error.spent = 0.0
            _, processor, _ = decide(chooser, robot, voxel_map, SIDE, repeat)
            if repeat:  # the first one compiles
                times[name].append(processor)
                times["prediction"] += [error.spent] if name == "fiducials" else []
    medians = {f"{name}_s": round(float(np.median(each)), 4) for name, each in times.items()}
    share = medians["prediction_s"] / medians["drift_s"]
    print(json.dumps({"fiducials": options.fiducials, **medians, "share": round(share, 4)}))


if __name__ == "__main__":
    main()
