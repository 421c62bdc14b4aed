"""Trajectory errors of localization on real and simulated sequences, against baselines.

Every sequence goes through `infomap_ros.replay.localize_run.LocalizeRun` with the
default settings; the rover's bag with its odometry and from the images alone. The baselines
follow the same views without odometry: from frame to frame (`odometry_baselines.py`), or by a
smoother (`klt_smoother.py`). Errors are those of evo (`trajectory_errors.py`) against the
sequence's truth. Prints a table and one JSON line.

    python benchmarks/localize_sequences.py [--data FOLDER] [--work FOLDER] [--only NAME ...]
        [--baselines NAME ...]

Real sequences are looked for in `--data` (default: INFOMAP_DATA or ../shared/data) and converted
into bags in `--work`; those that are absent are named and left out.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from klt_smoother import klt_gtsam
from odometry_baselines import BASELINES as FRAME_TO_FRAME
from stereo_bag import write_stereo_bag
from trajectory_errors import TrajectoryErrors, pose_nees, trajectory_errors, truth_at

from infomap_ros.cli.command_options import with_settings
from infomap_ros.geometry import PoseRecord
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.pipeline.perception import FramedView
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.localize_run import (
    LocalizeOptions,
    LocalizeRun,
    find_localize_inputs,
    records_of,
)
from infomap_ros.replay.sequences import SequenceOptions, convert

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Sequence:
    """What is compared.

    Attributes:
        form: of `infomap convert`; ``loop`` is drawn here, ``bag`` is a bag already.
        folder: below the data folder, or of the bag below the checkout.
        truth: topic.
        delta: length of the pieces over which relative errors are taken [m].
        settings: other than the defaults.
        options: of the conversion.
        truth_sigmas: how exact the truth is, position and rotation [m, rad].
    """

    form: str
    folder: str
    truth: str
    delta: float
    settings: tuple[str, ...] = ()
    options: SequenceOptions = field(default_factory=SequenceOptions)
    truth_sigmas: tuple[float, float] = (0.0, 0.0)


BASELINES = {"klt_gtsam": klt_gtsam, **FRAME_TO_FRAME}
OXTS = (0.02, 0.0017)
"""Of KITTI's truth, by the data sheet of its OXTS RT 3003: 2 cm, 0.1 degrees of heading."""
MOCAP = (0.0005, 0.003)
"""Of the motion capture of TUM-VI, and of the calibration between markers and camera."""
FUSION = (0.02, 0.023)
"""Of the truth of 7-Scenes, by KinectFusion: pairs of its own frames differ by so much."""
KITCHEN = SequenceOptions(
    calibration=(Path(__file__).parent / "calibrations" / "rgbd_kitchen.yaml",),
    rate=30.0,
    down=(0.0, 0.893, 0.450),  # from planes fitted to floor and table in six frames
)
SEQUENCES = {
    "rover_rocks": Sequence("bag", "bags/rover_rocks", "/ground_truth/camera_pose", 0.5),
    "rover_rocks, images alone": Sequence(
        "bag", "bags/rover_rocks", "/ground_truth/camera_pose", 0.5, ("input.motion=none",)
    ),
    "room loop": Sequence("loop", "room_loop", "/camera_pose", 0.5),
    "tumvi_room1": Sequence("euroc", "tumvi_room1", "/camera_pose", 0.03, truth_sigmas=MOCAP),
    "stereo_kitti_03": Sequence("kitti", "stereo_kitti_03", "/camera_pose", 1.0, truth_sigmas=OXTS),
    "stereo_kitti_curve": Sequence(
        "kitti", "stereo_kitti_curve", "/camera_pose", 10.0, truth_sigmas=OXTS
    ),
    "rgbd_kitchen": Sequence("rgbd", "rgbd_kitchen", "/camera_pose", 0.5, (), KITCHEN, FUSION),
}


def bag_of(sequence: Sequence, data: Path, work: Path) -> Path | None:
    """The sequence as a bag; None where its data are absent."""
    if sequence.form == "bag":
        return ROOT / sequence.folder
    bag = work / sequence.folder
    if sequence.form == "loop":
        return write_stereo_bag(bag, frames=120, turns=1.2, radius=0.6)
    if not (data / sequence.folder).is_dir():
        return None
    if not (bag / "metadata.yaml").exists():
        convert(sequence.form, data / sequence.folder, bag, sequence.options, overwrite=True)
    return bag


def views_of(bag: BagReader, options: LocalizeOptions) -> Iterator[RangeView]:
    """The views that localization sees."""
    inputs = find_localize_inputs(bag, options)
    perception = inputs.perception
    for entry in perception.see(records_of(bag, perception.sources.names)):
        if isinstance(entry, FramedView):
            yield entry.view


def compare(path: Path, sequence: Sequence, baselines: list[str]) -> dict[str, dict[str, float]]:
    """Figures of localization and of each baseline, by name."""
    options = with_settings(LocalizeOptions(), sequence.settings)
    with BagReader(path) as bag:
        records = [entry.record for entry in bag.records([sequence.truth])]
        truth = [record for record in records if isinstance(record, PoseRecord)]
        start = time.perf_counter()
        run = LocalizeRun(bag, options)
        run.run()
        seconds = time.perf_counter() - start
    total = len(run.log.localizations)
    results = {}
    for name, trajectory in (
        ("localization", run.log.trajectory),
        ("localization, corrected", run.log.corrected_trajectory),
    ):
        errors = errors_of(truth, trajectory.stamps.tolist(), trajectory.transforms, sequence.delta)
        located = {"views": total, "not_located": total - len(trajectory), "seconds": seconds}
        results[name] = asdict(errors) | located
    located = run.log.trajectory
    results["localization"] |= nees_of(
        truth, located.stamps.tolist(), located.transforms, located.covariances, sequence
    )
    for name in baselines:
        start = time.perf_counter()
        with BagReader(path) as bag:
            stamps, poses, failures, covariances = BASELINES[name](views_of(bag, options))
        seconds = time.perf_counter() - start
        results[name] = asdict(errors_of(truth, stamps, poses, sequence.delta)) | {
            "views": len(stamps),
            "not_located": failures,
            "seconds": seconds,
        }
        if covariances is not None:
            results[name] |= nees_of(truth, stamps, poses, covariances, sequence)
    return results


def nees_of(
    truth: list[PoseRecord],
    stamps: list[int],
    poses: np.ndarray,
    covariances: np.ndarray,
    sequence: Sequence,
) -> dict[str, float]:
    known, reference = truth_at(truth, stamps)
    nees = pose_nees(reference, poses[known], covariances[known], sequence.truth_sigmas)
    return {"nees_median": float(np.median(nees)), "nees_mean": float(np.mean(nees))}


def errors_of(
    truth: list[PoseRecord], stamps: list[int], poses: np.ndarray, delta: float
) -> TrajectoryErrors:
    known, reference = truth_at(truth, stamps)
    return trajectory_errors(np.array(stamps)[known], reference, poses[known], delta)


def row(name: str, method: str, figures: dict[str, float]) -> str:
    """One line of the table in docs/localization.md."""
    return (
        f"| {name} | {method} | {int(figures['views'])} | {int(figures['not_located'])} "
        f"| {1e3 * figures['ape']:.1f} | {figures['rpe_percent']:.2f} "
        f"| {figures['rpe_degrees']:.2f} | {1e3 * figures['frame_rpe']:.2f} |"
    )


def add_folders(parser: argparse.ArgumentParser) -> None:
    """Options for where the data are, and where bags are made of them."""
    default = os.environ.get("INFOMAP_DATA", str(ROOT.parent / "shared" / "data"))
    parser.add_argument("--data", type=Path, default=Path(default))
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "bench" / "sequences")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_folders(parser)
    parser.add_argument("--only", nargs="*", default=list(SEQUENCES), choices=list(SEQUENCES))
    names = list(BASELINES)
    parser.add_argument("--baselines", nargs="*", default=names, choices=names)
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    print(
        "| sequence | method | views | not located | APE [mm] | RPE [%] | RPE [deg] | frame [mm] |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    results: dict[str, object] = {}
    for name in arguments.only:
        bag = bag_of(SEQUENCES[name], arguments.data, arguments.work)
        if bag is None:
            print(f"| {name} | absent | | | | | | |")
            continue
        results[name] = compared = compare(bag, SEQUENCES[name], arguments.baselines)
        for method, figures in compared.items():
            print(row(name, method, figures), flush=True)
    print(json.dumps({"benchmark": "localize_sequences", "results": results}))


if __name__ == "__main__":
    main()
