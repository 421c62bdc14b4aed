"""Which descriptor finds fiducials again: the package's against OpenCV's detectors and descriptors.

Pairs of views of one place, some time apart, of real sequences and of a drawn drive. 100 fiducials
are chosen in the first; a pose and ranges tell where they are in the second. Found: the share of
those in view that is matched within 5 px (15 px in the kitchen, whose poses are that good). Wrong:
the share of the matches that is elsewhere. Time: processor time of one core to describe and match.

    python benchmarks/appearance_matching.py [--data FOLDER] [--work FOLDER] [--drawn]

AKAZE and BRISK are compared where OpenCV has them (since 5.0: opencv-contrib-python-headless).
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from drawn_drive import draw, unchanged
from localize_sequences import ROOT, SEQUENCES, bag_of, views_of
from trajectory_errors import truth_at

from infomap_ros.geometry import PoseRecord, invert_transform, transform_points
from infomap_ros.localization.fiducials.appearance import (
    MAX_RATIO,
    corners_of,
    describe,
    find_again,
)
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.fiducials.selection import select_fiducials
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.localize_run import LocalizeOptions

Matcher = Callable[[RangeView, np.ndarray, RangeView], tuple[np.ndarray, np.ndarray]]
"""First view, fiducials in it, second view -> rows of the fiducials, pixels in the second."""


class Pair(NamedTuple):
    """Two views with their poses."""

    scene: str
    first: RangeView
    first_pose: np.ndarray
    second: RangeView
    second_pose: np.ndarray


def package(
    first: RangeView, pixels: np.ndarray, second: RangeView
) -> tuple[np.ndarray, np.ndarray]:
    """`localization.appearance`."""
    found = find_again(second, describe(first.image, pixels))
    return found.indices, found.pixels


def described(extractor: cv2.Feature2D, size: float) -> Matcher:
    """An OpenCV descriptor, upright, of one size [px], at the same corners."""

    def at(image: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points = [
            cv2.KeyPoint(float(u), float(v), size, 0.0, 1.0, 0, k)
            for k, (u, v) in enumerate(pixels)
        ]
        kept, descriptors = extractor.compute(image, points)
        return np.array([p.class_id for p in kept], int), descriptors

    def match(first: RangeView, pixels: np.ndarray, second: RangeView):  # type: ignore[no-untyped-def]
        corners = corners_of(second.image)
        (a, da), (b, db) = at(first.image, pixels), at(second.image, corners)
        rows, columns = _mutual(da, db)
        return a[rows], corners[b[columns]]

    return match


def detected(extractor: cv2.Feature2D) -> Matcher:
    """An OpenCV detector and its descriptor; a fiducial is the nearest keypoint within 4 px."""

    def match(first: RangeView, pixels: np.ndarray, second: RangeView):  # type: ignore[no-untyped-def]
        (ka, da), (kb, db) = (extractor.detectAndCompute(v.image, None) for v in (first, second))
        a, b = (np.array([k.pt for k in keypoints]) for keypoints in (ka, kb))
        apart = np.linalg.norm(pixels[:, None] - a, axis=2)
        near = np.flatnonzero(apart.min(axis=1) < 4.0)
        nearest = apart.argmin(axis=1)[near]
        rows, columns = _mutual(da[nearest], db)
        return near[rows], b[columns] + pixels[near[rows]] - a[nearest[rows]]

    return match


def _mutual(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mutual best matches that pass the ratio test of the package."""
    norm = cv2.NORM_HAMMING if first.dtype == np.uint8 else cv2.NORM_L2
    matcher = cv2.BFMatcher(norm)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(second, first)}
    good = [
        (best.queryIdx, best.trainIdx)
        for best, other in matcher.knnMatch(first, second, k=2)
        if best.distance <= MAX_RATIO * other.distance and back[best.trainIdx] == best.queryIdx
    ]
    rows = np.array(good, int).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def matchers() -> dict[str, Matcher]:
    """What is compared, by name."""
    extra = getattr(cv2, "xfeatures2d", cv2)
    found = {
        "package": package,
        "SIFT at corners, 6 px": described(cv2.SIFT.create(), 6.0),
        "SIFT at corners, 12 px": described(cv2.SIFT.create(), 12.0),
        "ORB at corners": described(cv2.ORB.create(edgeThreshold=16, patchSize=31), 31.0),
        "SIFT": detected(cv2.SIFT.create(1500)),
        "ORB": detected(cv2.ORB.create(1500)),
    }
    if hasattr(extra, "AKAZE"):
        found["AKAZE"] = detected(extra.AKAZE.create(threshold=3e-4))
    if hasattr(extra, "BRISK"):
        found["BRISK"] = detected(extra.BRISK.create(20))
    return found


def pairs(data: Path, work: Path) -> Iterator[Pair]:
    """Views of one place some time apart."""
    steps = {"rover_rocks": (1, 3), "rgbd_kitchen": (20, 20), "tumvi_room1": (10, 4)}
    for name, (gap, every) in steps.items():
        bag = bag_of(SEQUENCES[name], data, work)
        if bag is None:
            continue
        with BagReader(bag) as reader:
            records = [entry.record for entry in reader.records([SEQUENCES[name].truth])]
            truth = [record for record in records if isinstance(record, PoseRecord)]
            views = list(islice(views_of(reader, LocalizeOptions()), 60))
        known, poses = truth_at(truth, [view.stamp for view in views])
        placed = list(zip(np.array(views, dtype=object)[known], poses, strict=True))
        for k in range(0, len(placed) - gap, every):
            yield Pair(name, *placed[k], *placed[k + gap])


def drawn_pairs() -> Iterator[Pair]:
    """Views of a drawn drive."""
    drive, rng = draw(21, 0.03, 0.03, 7), np.random.default_rng(0)
    for a, b in ((0, 10), (10, 20), (20, 10), (0, 20), (20, 0)):
        views = [drive[k].view(k, unchanged, rng) for k in (a, b)]
        yield Pair("drawn drive", views[0], drive[a].pose, views[1], drive[b].pose)


def expected(pair: Pair, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where fiducials are in the second view, and whether its ranges say that they are in sight."""
    camera = pair.first.camera
    depth = 1.0 / pair.first.inverse_depths(pixels)[0]
    across = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    points = np.column_stack([across, np.ones(len(depth))]) * depth[:, None]
    there = transform_points(invert_transform(pair.second_pose) @ pair.first_pose, points)
    places = camera.project(there)
    with np.errstate(invalid="ignore"):
        inside = ((places > 16) & (places < [camera.width - 17, camera.height - 17])).all(axis=1)
    inverse = pair.second.inverse_depths(np.where(inside[:, None], places, 0.0))[0]
    return places, inside & (np.abs(inverse * there[:, 2] - 1.0) < 0.06)


def main() -> None:
    """Compare and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = ROOT.parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("INFOMAP_DATA", shared)))
    parser.add_argument("--work", type=Path, default=Path("out/sequences"))
    parser.add_argument("--drawn", action="store_true", help="compare in a drawn drive too")
    arguments = parser.parse_args()
    sums: dict[tuple[str, str], np.ndarray] = {}
    compared = pairs(arguments.data, arguments.work)
    for pair in chain(compared, drawn_pairs() if arguments.drawn else ()):
        pixels = select_fiducials(pair.first, [], 100)
        places, visible = expected(pair, pixels)
        limit = 15.0 if pair.scene == "rgbd_kitchen" else 5.0
        for name, matcher in matchers().items():
            start = time.process_time()
            rows, found = matcher(pair.first, pixels, pair.second)
            seconds = time.process_time() - start
            right = np.linalg.norm(found - places[rows], axis=1) < limit
            seen = visible[rows]
            counts = [visible.sum(), (right & seen).sum(), (~right & seen).sum(), seconds, 1.0]
            sums[pair.scene, name] = sums.get((pair.scene, name), 0.0) + np.array(counts)
    scenes = list(dict.fromkeys(scene for scene, _ in sums))
    print("| |", " | ".join(scenes), "|")
    for name in matchers():
        cells = []
        for scene in scenes:
            visible, right, wrong, seconds, count = sums[scene, name]
            error = 100 * wrong / max(right + wrong, 1.0)
            milliseconds = 1e3 * seconds / count
            cells.append(
                f"{100 * right / visible:.0f} %, {error:.0f} % wrong, {milliseconds:.0f} ms"
            )
        print(f"| {name} |", " | ".join(cells), "|")


if __name__ == "__main__":
    main()
