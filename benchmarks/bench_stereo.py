"""Cost of stereo ranging besides the matcher, against the matcher, in one run.

Raw 640x480 pairs, gray and RGB, 128 disparities. The matcher alone is OpenCV's SGBM in mode 3WAY
with the sensor's settings; everything else is rectification, gray conversion, checks, refinement,
covariances and the bytes of the message. Both sides use the same number of threads and runs
alternate; times are medians, the ratio is that of the shortest times, which other load on the
machine disturbs least. The process runs under the environment of the nodes (the C library keeps
freed memory). Prints one JSON line.

    python benchmarks/bench_stereo.py [--runs 60]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import cv2
import numpy as np

import infomap_ros.nodes  # noqa: F401  sets how memory is used, as for the nodes
from infomap_ros.geometry import CameraCalibration
from infomap_ros.stereo import StereoConfig, StereoRangeSensor, StereoRectifier
from infomap_ros.stereo.images import gray
from infomap_ros.stereo.matching import BLOCK_SIZE, SMOOTHNESS_LARGE, SMOOTHNESS_SMALL

WIDTH, HEIGHT, FOCAL, BASELINE = 640, 480, 525.0, 0.12
NEAREST = 0.482  # [m]: disparities 4 to 131


def calibrations() -> tuple[CameraCalibration, CameraCalibration]:
    k = np.array([[FOCAL, 0, 319.5], [0, FOCAL, 239.5], [0, 0, 1.0]])
    distortion = np.array([-0.1, 0.02, 0.0, 0.0, 0.0])
    projections = [np.c_[k, [shift, 0.0, 0.0]] for shift in (0.0, -FOCAL * BASELINE)]
    left, right = (
        CameraCalibration(WIDTH, HEIGHT, "plumb_bob", distortion, k, np.eye(3), p)
        for p in projections
    )
    return left, right


def textured_pair(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Gray images of a wavy textured surface, 20 to 80 px."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.standard_normal((HEIGHT, 2 * WIDTH)), (0, 0), 1.5)
    texture = (128.0 + 40.0 * texture / texture.std()).astype(np.float32)
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    shift = 50.0 + 30.0 * np.sin(u / 110.0) * np.cos(v / 80.0)
    images = []
    for columns in (u, u + shift):
        image = cv2.remap(texture, columns, v, cv2.INTER_LINEAR) + rng.normal(0, 2, u.shape)
        images.append(np.clip(image, 0, 255).astype(np.uint8))
    return images[0], images[1]


def milliseconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - start)


def measure(threads: int, color: bool, runs: int) -> dict[str, float]:
    cv2.setNumThreads(threads)
    rectifier = StereoRectifier(*calibrations())
    config = StereoConfig(min_depth=NEAREST, max_depth=15.0, threads=threads)
    sensor = StereoRangeSensor(rectifier.rig, config)
    raw = textured_pair(0)
    if color:
        raw = tuple(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) for image in raw)
    rectified = rectifier.rectify(*raw)
    left, right = (gray(image) for image in rectified)
    disparity = sensor.match(left, right)
    plain = cv2.StereoSGBM.create(
        minDisparity=sensor.search.minimum,
        numDisparities=sensor.search.count,
        blockSize=BLOCK_SIZE,
        P1=SMOOTHNESS_SMALL * BLOCK_SIZE**2,
        P2=SMOOTHNESS_LARGE * BLOCK_SIZE**2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )

    def rest() -> bytes:
        pair = rectifier.rectify(*raw, gray_right=True)
        grays = [gray(image) for image in pair]
        return sensor.measure_matched(pair[0], *grays, disparity).packed.tobytes()

    works = {
        "sgbm": lambda: plain.compute(left, right),
        "rest": rest,
        "rectify": lambda: rectifier.rectify(*raw, gray_right=True),
        "whole": lambda: sensor.measure(*rectifier.rectify(*raw, gray_right=True)).packed.tobytes(),
    }
    rest()
    times = {name: [] for name in works}
    for _ in range(runs):
        for name, work in works.items():
            times[name].append(milliseconds(work))
    result = {f"{name}_ms": round(float(np.median(t)), 2) for name, t in times.items()}
    ratio = min(times["rest"]) / min(times["sgbm"])
    result["disparities"] = sensor.search.count
    return {**result, "rest_per_sgbm": round(float(ratio), 3)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=60)
    runs = parser.parse_args().runs
    results = {
        f"{name}_threads_{threads}": measure(threads, color, runs)
        for name, color in (("gray", False), ("rgb", True))
        for threads in (1, 2)
    }
    size = {"width": WIDTH, "height": HEIGHT}
    print(json.dumps({"benchmark": "stereo", **size, **results}))


if __name__ == "__main__":
    main()
