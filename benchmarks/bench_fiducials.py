"""How well and how fast fiducials are tracked: exact truth in a drawn drive, lengths on real data.

    python benchmarks/bench_fiducials.py drawn [--frames 24]
    python benchmarks/bench_fiducials.py real [--data FOLDER] [--work FOLDER]
    python benchmarks/bench_fiducials.py pairs [--data FOLDER]
    python benchmarks/bench_fiducials.py figure FILE

`drawn`: a slow drive (2 cm and up to 0.9 degrees per pair) and a fast one (5 cm, up to 3.4
degrees), disturbed in the ways of `CASES`, without prediction. Of the fiducials that truth says are
in view and not hidden, the share that is seen; errors of pixels against the projection of the point
that was first chosen, and of disparities, with the shares within 1, 2 and 3 stated sigmas (a
Gaussian has 68 / 95 / 99.7 %). Times are processor time of one core per pair of 640x480: tracking
with the ranges of all fiducials, rectification excluded; and of choosing 100 fiducials in an empty
view.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from drawn_drive import BASELINE, FOCAL, Disturbance, Moment, draw, unchanged
from localize_sequences import ROOT, SEQUENCES, bag_of, views_of

from infomap_ros.geometry.atomic_file import replacing
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.fiducials.selection import (
    FiducialSelectionConfig,
    corner_candidates,
    select_fiducials,
)
from infomap_ros.localization.fiducials.sparse_stereo import match_pixels
from infomap_ros.localization.fiducials.tracker import FiducialTracker
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.localize_run import LocalizeOptions
from infomap_ros.stereo.evaluation import load_pairs
from infomap_ros.stereo.images import gray

COUNT = 100
_LIGHT = ((1.0, 0.0), (0.5, 0.0), (1.3, 10.0), (0.7, 40.0))


def light_steps(light: np.ndarray, k: int) -> np.ndarray:
    """Another gain and offset in every image."""
    gain, offset = _LIGHT[k % 4]
    return gain * light + offset


def blur_of(sigma: float) -> Disturbance:
    """Every third image is blurred."""
    return lambda light, k: cv2.GaussianBlur(light, (0, 0), sigma) if k % 3 == 2 else light


def shaken(light: np.ndarray, _: int) -> np.ndarray:
    """Every image is smeared over 9 px along its rows."""
    return cv2.blur(light, (9, 1))


CASES: dict[str, tuple[Disturbance, int]] = {
    "undisturbed": (unchanged, 1),
    "light changes every pair": (light_steps, 1),
    "every 3rd pair blurred by 2 px": (blur_of(2.0), 1),
    "every 3rd pair blurred by 4 px": (blur_of(4.0), 1),
    "all smeared over 9 px": (shaken, 1),
    "1 of 2 pairs lost": (unchanged, 2),
    "3 of 4 pairs lost": (unchanged, 4),
}
"""Disturbance and how many pairs there are to one that arrives."""


@dataclass
class Figures:
    """What a run over views gives."""

    seen: int = 0
    visible: int = 0
    lengths: Counter[int] = field(default_factory=Counter)
    pixel_errors: list[np.ndarray] = field(default_factory=list)
    normalized: list[np.ndarray] = field(default_factory=list)
    disparity_errors: list[np.ndarray] = field(default_factory=list)
    normalized_disparity: list[np.ndarray] = field(default_factory=list)
    track_times: list[float] = field(default_factory=list)
    select_times: list[float] = field(default_factory=list)

    def row(self, name: str) -> str:
        """One line of the table in docs/localization.md."""
        pixels = np.concatenate(self.pixel_errors)
        disparities = np.concatenate(self.disparity_errors)
        ok = np.isfinite(disparities)
        return (
            f"| {name} | {100 * self.seen / self.visible:.0f} % "
            f"| {np.mean(list(self.lengths.values())):.1f} "
            f"| {np.quantile(pixels, 0.68):.2f} / {np.quantile(pixels, 0.99):.2f} "
            f"| {_shares(np.concatenate(self.normalized))} "
            f"| {np.quantile(np.abs(disparities[ok]), 0.68):.3f} "
            f"| {_shares(np.concatenate(self.normalized_disparity)[ok])} "
            f"| {1e3 * np.median(self.track_times):.1f} |"
        )


def _shares(values: np.ndarray) -> str:
    finite = np.abs(values[np.isfinite(values)])
    return " / ".join(f"{100 * (finite < k).mean():.0f}" for k in (1, 2, 3))


def follow(moments: list[Moment], disturb: Disturbance) -> Figures:
    """Track through a drawn drive and compare with its truth."""
    figures, tracker, rng = Figures(), FiducialTracker(), np.random.default_rng(1)
    points = np.zeros((0, 3))  # by id
    for k, moment in enumerate(moments):
        view = moment.view(k, disturb, rng)
        known = tracker.ids
        start = time.process_time()
        seen = tracker.track(view)
        figures.track_times.append(time.process_time() - start)
        visible = known[moment.sees(points[known])]
        figures.visible += len(visible)
        figures.seen += int(np.isin(visible, seen.ids).sum())
        figures.lengths.update(seen.ids.tolist())
        _compare(figures, moment, points, seen)
        pixels = select_fiducials(view, tracker.pixels, COUNT - len(tracker.ids))
        ids = np.arange(len(points), len(points) + len(pixels))
        tracker.add(view, ids, pixels)
        points = np.concatenate([points, moment.points(pixels)])
    return figures


def _compare(figures: Figures, moment: Moment, points: np.ndarray, seen: object) -> None:
    errors = seen.pixels - moment.project(points[seen.ids])
    true = np.isfinite(errors).all(axis=1)
    figures.pixel_errors.append(np.linalg.norm(errors[true], axis=1))
    figures.normalized.append((errors[true] / seen.pixel_sigmas[true, None]).ravel())
    error = seen.inverse_depths - moment.inverse_depths(seen.pixels)
    figures.disparity_errors.append(error * FOCAL * BASELINE)
    figures.normalized_disparity.append(error / seen.inverse_depth_sigmas)


def drawn(frames: int) -> None:
    """Print the table of the drawn drives."""
    drives = {"slow": draw(frames, 0.02, 0.015, 7), "fast": draw(frames, 0.05, 0.06, 11)}
    follow(drives["slow"][:3], unchanged)  # compiles
    for drive, moments in drives.items():
        for name, (disturb, every) in CASES.items():
            print(follow(moments[::every], disturb).row(f"{drive}, {name}"), flush=True)
    view = drives["slow"][0].view(0, unchanged, np.random.default_rng(0))
    times = []
    for _ in range(9):
        start = time.process_time()
        select_fiducials(view, [], COUNT)
        times.append(time.process_time() - start)
    print(f"choosing {COUNT} fiducials: {1e3 * np.median(times):.1f} ms")


def pairs(data: Path) -> None:
    """Print the errors of sparse disparities at corners of pairs with true disparity."""
    loaded = [*load_pairs(data / "stereo_motorcycle"), *load_pairs(data / "stereo_opencv_samples")]
    for pair in [half for whole in loaded for half in (whole, whole.halved())]:
        left, right = gray(pair.left), gray(pair.right)
        corners = corner_candidates(left, np.zeros((0, 2)), FiducialSelectionConfig(candidates=999))
        lowest = -math.ceil(pair.rig.principal_offset) - 2
        search = (lowest, pair.disparities)
        disparity, sigma = match_pixels(left, right, corners, search)
        error = disparity - _smooth_truth(pair.truth, corners)
        matched = np.isfinite(error)
        total = np.hypot(sigma, pair.truth_sigma)[matched & (np.abs(error) < 1.5)]
        good = error[matched & (np.abs(error) < 1.5)]
        print(
            f"| {pair.name}, {left.shape[1]}x{left.shape[0]} "
            f"| {100 * np.isfinite(disparity).mean():.0f} % "
            f"| {100 * (np.abs(error[matched]) >= 1.5).mean():.1f} % "
            f"| {np.quantile(np.abs(good), 0.68):.2f} | {np.median(good):.2f} "
            f"| {np.median(sigma[matched]):.2f} | {_shares(good / total)} |"
        )


def _smooth_truth(truth: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Mean of 5x5 px of the truth; NaN at depth edges and where any of it is missing."""
    values = np.full(len(corners), np.nan)
    for k, (u, v) in enumerate(corners.astype(int)):
        if np.ptp(truth[v - 6 : v + 7, u - 6 : u + 7]) < 6.0:
            values[k] = truth[v - 2 : v + 3, u - 2 : u + 3].mean()
    return values


def real(data: Path, work: Path) -> None:
    """Print how long fiducials are followed in real sequences."""
    for name in ("rover_rocks", "tumvi_room1", "rgbd_kitchen"):
        bag = bag_of(SEQUENCES[name], data, work)
        if bag is None:
            print(f"| {name} | absent |")
            continue
        with BagReader(bag) as reader:
            print(f"| {name} {lengths(views_of(reader, LocalizeOptions()))} |", flush=True)


def lengths(views: Iterator[RangeView]) -> str:
    """Views, size, median share that is seen again, lengths of tracks, milliseconds per view."""
    tracker, next_id, tracked, shares, times = FiducialTracker(), 0, Counter[int](), [], []
    size, count = "", 0
    for view in views:
        before = len(tracker.ids)
        start = time.process_time()
        seen = tracker.track(view)
        if before:
            times.append(time.process_time() - start)
            shares.append(len(seen) / before)
        tracked.update(seen.ids.tolist())
        pixels = select_fiducials(view, tracker.pixels, COUNT - len(tracker.ids))
        tracker.add(view, np.arange(next_id, next_id + len(pixels)), pixels)
        next_id += len(pixels)
        size, count = f"{view.image.shape[1]}x{view.image.shape[0]}", count + 1
    long = np.quantile(list(tracked.values()), [0.5, 0.9])
    return (
        f"| {count} of {size} | {100 * np.median(shares):.0f} % "
        f"| {long[0]:.0f} / {long[1]:.0f} | {1e3 * np.median(times):.1f}"
    )


def figure(file: Path) -> None:
    """Draw the fiducials chosen in a view of the shipped bag, and where they went until later."""
    tracker, first, canvas = FiducialTracker(), {}, None
    with BagReader(ROOT / SEQUENCES["rover_rocks"].folder) as reader:
        for k, view in enumerate(views_of(reader, LocalizeOptions())):
            if k == 0:
                pixels = select_fiducials(view, [], 60)
                first = dict(enumerate(pixels))
                tracker.add(view, np.arange(len(pixels)), pixels)
                canvas = cv2.cvtColor(view.image, cv2.COLOR_GRAY2BGR)
            elif k <= 2:
                seen = tracker.track(view)
    for u, v in np.rint(np.array(list(first.values()))).astype(int).tolist():
        cv2.circle(canvas, (u, v), 5, (0, 200, 255), 1, cv2.LINE_AA)
    for name, pixel in zip(seen.ids.tolist(), seen.pixels, strict=True):
        ends = [tuple(np.rint(p).astype(int).tolist()) for p in (first[name], pixel)]
        cv2.line(canvas, *ends, (80, 255, 80), 1, cv2.LINE_AA)
    with replacing(file) as written:
        written.write(cv2.imencode(file.suffix, canvas)[1].tobytes())


def main() -> None:
    """Parse the command line and run one part."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=("drawn", "real", "pairs", "figure"))
    parser.add_argument("file", nargs="?", type=Path, default=Path("fiducials.png"))
    parser.add_argument("--frames", type=int, default=24)
    shared = ROOT.parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("INFOMAP_DATA", shared)))
    parser.add_argument("--work", type=Path, default=Path("out/sequences"))
    arguments = parser.parse_args()
    if arguments.part == "drawn":
        drawn(arguments.frames)
    elif arguments.part == "real":
        real(arguments.data, arguments.work)
    elif arguments.part == "pairs":
        pairs(arguments.data)
    else:
        figure(arguments.file)


if __name__ == "__main__":
    main()
