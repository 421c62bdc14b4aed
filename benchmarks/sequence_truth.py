"""How good the truth of rgbd_kitchen is: what its depth images say of it.

The poses of that sequence were estimated from its depth images. Here pairs of depth images, some
frames apart, are registered by generalized ICP (small_gicp), once from the motion that the truth
tells and once from that of localization. Both starts end at the same motion where the images
determine it; how far each start is from it tells how good it was, and the distance of the points
from the planes of the other image says so without any reference.

    python benchmarks/sequence_truth.py [--data FOLDER] [--work FOLDER] [--gap 30]
"""

from __future__ import annotations

import argparse
import json

import numpy as np
import small_gicp
from localize_sequences import SEQUENCES, add_folders, bag_of, views_of
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PoseRecord, invert_transform, transform_points
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.localize_run import LocalizeOptions, LocalizeRun

EVERY = 12  # pairs begin at every so many frames
FARTHEST = 2.5  # [m]
VOXEL = 0.02  # [m]


def prepared(points: np.ndarray) -> tuple[small_gicp.PointCloud, small_gicp.KdTree]:
    near = points.reshape(-1, 3)[::4].astype(np.float64)
    near = near[np.isfinite(near).all(axis=1) & (near[:, 2] < FARTHEST)]
    return small_gicp.preprocess_points(near, VOXEL, num_threads=1)


def plane_distance(first: small_gicp.PointCloud, second: small_gicp.PointCloud, T) -> float:
    """Median distance of the second cloud's points from the planes of the first [mm]."""
    points, normals = first.points()[:, :3], first.normals()[:, :3]
    moved = transform_points(T, second.points()[:, :3])
    apart, nearest = cKDTree(points).query(moved, distance_upper_bound=0.1)
    found = np.isfinite(apart)
    offsets = moved[found] - points[nearest[found]]
    return 1e3 * float(np.median(np.abs((offsets * normals[nearest[found]]).sum(axis=1))))


def difference(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Degrees and millimeters between two motions."""
    between = invert_transform(first) @ second
    turn = Rotation.from_matrix(between[:3, :3]).magnitude()
    return float(np.degrees(turn)), 1e3 * float(np.linalg.norm(between[:3, 3]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_folders(parser)
    parser.add_argument("--gap", type=int, default=30, help="frames between the two images")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    path = bag_of(SEQUENCES["rgbd_kitchen"], arguments.data, arguments.work)
    if path is None:
        raise SystemExit(f"no rgbd_kitchen in {arguments.data}")
    with BagReader(path) as bag:
        records = [entry.record for entry in bag.records(["/camera_pose"])]
        truth = {r.stamp: r.transform for r in records if isinstance(r, PoseRecord)}
        run = LocalizeRun(bag)
        run.run()
        found = run.log.trajectory
        estimate = dict(zip(found.stamps.tolist(), found.transforms, strict=True))
        stamps = [stamp for stamp in truth if stamp in estimate]
        starts = range(0, len(stamps) - arguments.gap, EVERY)
        wanted = {stamps[i] for i in starts} | {stamps[i + arguments.gap] for i in starts}
        clouds = {
            view.stamp: prepared(view.cloud().organized_points)
            for view in views_of(bag, LocalizeOptions())
            if view.stamp in wanted
        }
    rows = []
    for index in starts:
        a, b = stamps[index], stamps[index + arguments.gap]
        (first, tree), (second, _) = clouds[a], clouds[b]
        row: list[float] = []
        ends = []
        for poses in (truth, estimate):
            begin = invert_transform(poses[a]) @ poses[b]
            end = small_gicp.align(
                first, second, tree, begin, max_correspondence_distance=0.08, num_threads=1,
                max_iterations=60,
            ).T_target_source  # fmt: skip
            ends.append(end)
            row += [*difference(end, begin), plane_distance(first, second, begin)]
        motion = invert_transform(truth[a]) @ truth[b]
        row += [plane_distance(first, second, ends[0]), *difference(*ends)]
        rows.append([*row, 1e3 * float(np.linalg.norm(motion[:3, 3]))])
    names = (
        "truth_deg", "truth_mm", "truth_plane_mm", "localization_deg", "localization_mm",
        "localization_plane_mm", "registered_plane_mm", "starts_deg", "starts_mm", "motion_mm",
    )  # fmt: skip
    medians = dict(zip(names, np.median(rows, axis=0).round(3).tolist(), strict=True))
    print(
        json.dumps(
            {"benchmark": "sequence_truth", "gap": arguments.gap, "pairs": len(rows)} | medians
        )
    )


if __name__ == "__main__":
    main()
