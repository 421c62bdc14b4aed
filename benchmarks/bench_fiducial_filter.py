"""Processor time of one image in the fiducial filter, with its state full.

OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/bench_fiducial_filter.py
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np

from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.studies.pose_consistency import CAMERA, Room, circle, odometry

FIDUCIALS = 800  # in the room
MEASURED = 60
WARM, COUNTED = 60, 40  # images


def timed(times: list[float], work: Callable[[], object]) -> object:
    """What the work gives; its processor time is noted [s]."""
    start = time.process_time()
    result = work()
    times.append(time.process_time() - start)
    return result


def main() -> None:
    rng = np.random.default_rng(0)
    room = Room.random(FIDUCIALS, 0.0, rng)
    poses = circle(WARM + COUNTED, 1.5)
    pose_filter = FiducialFilter(CAMERA, FiducialFilterConfig(max_fiducials=300, max_kept_poses=60))
    pose_filter.add(room.observe(poses[0], MEASURED, False, rng))
    times: dict[str, list[float]] = {"update": [], "add": [], "keep": []}
    used = []
    for number in range(1, len(poses)):
        pose_filter.predict(odometry(poses[number - 1], poses[number], rng))
        seen = room.observe(poses[number], MEASURED, False, rng)
        update = timed(times["update"], lambda seen=seen: pose_filter.update(seen))
        new = seen.select(np.isin(seen.ids, update.unknown))
        timed(times["add"], lambda new=new: pose_filter.add(new))
        timed(times["keep"], lambda number=number: pose_filter.keep_pose(number))
        used.append(len(update.used))
    figures = {
        f"{name}_ms": round(1e3 * float(np.median(values[WARM:])), 2)
        for name, values in times.items()
    }
    figures |= {
        "update_95_percent_ms": round(1e3 * float(np.quantile(times["update"][WARM:], 0.95)), 2),
        "fiducials": len(pose_filter.fiducials()),
        "kept_poses": len(pose_filter.kept_poses()),
        "used": float(np.median(used[WARM:])),
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
