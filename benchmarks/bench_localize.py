"""Cost of localizing by 640x480 pairs beside the stereo matcher, in one run.

Views of the room loop (10 Hz) go through the localizer, images alone; beside each, the dense
matcher (SGBM with the settings of the sensor) works on the same pair. One thread; times are of the
processor, which other load on the machine disturbs least. `sum_ms` below 100 ms keeps up with 10 Hz
on one core. Prints one JSON line.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/bench_localize.py [--views 100]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from localize_robustness import load
from localize_sequences import ROOT
from stereo_bag import write_stereo_bag

from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.localization.localizer import Localizer

Result = TypeVar("Result")
WARM_UP = 5  # views before times count


def timed(times: list[float], work: Callable[[], Result]) -> Result:
    start = time.process_time()
    result = work()
    times.append(1e3 * (time.process_time() - start))
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--views", type=int, default=100)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "bench" / "sequences")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    bag = write_stereo_bag(arguments.work / "room_loop", frames=120, turns=1.2, radius=0.6)
    recording = load(bag)
    shots = recording.shots[: arguments.views]
    localizer = Localizer(recording.sensor.rig.left)
    locating: list[float] = []
    matching: list[float] = []
    states = []
    for shot in shots:
        view = StereoView(shot.stamp, shot.left, shot.right, recording.sensor)
        result = timed(locating, lambda view=view: localizer.locate(view))
        states.append(result.state)
        timed(matching, lambda shot=shot: recording.sensor.match(shot.left, shot.right))
    locate, match = np.array(locating[WARM_UP:]), np.array(matching[WARM_UP:])
    figures = {
        "locate_ms": round(float(np.median(locate)), 2),
        "locate_mean_ms": round(float(locate.mean()), 2),
        "locate_p95_ms": round(float(np.percentile(locate, 95)), 2),
        "match_ms": round(float(np.median(match)), 2),
        "sum_ms": round(float(locate.mean() + match.mean()), 2),
        "locate_per_match": round(float(locate.mean() / match.mean()), 3),
        "fiducials_held": len(localizer.fiducials()),
        "views": len(shots),
        "tracking": states.count("tracking"),
    }
    print(json.dumps({"benchmark": "localize", "width": 640, "height": 480} | figures))


if __name__ == "__main__":
    main()
