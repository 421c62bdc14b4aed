"""What disturbances do to localization: it must recover or say that it is lost, never be wrong.

Each trial follows some undisturbed views of the room loop (10 Hz, exact truth, images alone), then
disturbed ones, then undisturbed ones again. It ends as

* recovered: the last view is tracked, and no pose on the way was wrong;
* honest: not tracked in the end, but every pose that was told was right within its covariance;
* lost: it says so in the end, and no pose that it told was wrong;
* wrong: a pose was told that is off by more than 1 cm or 10 mrad and by more than its covariance
  allows (squared distance above 55, which chance exceeds once in 10^9).

With `--gyroscope` turns come from the truth, with a constant error of 0.02 rad/s (1 sigma) and
noise of 0.5 mrad per root of a second.

    python benchmarks/localize_robustness.py [--trials 20] [--work FOLDER] [--only KIND ...]
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from localize_sequences import ROOT
from scipy.spatial.transform import Rotation
from stereo_bag import write_stereo_bag

from infomap_ros.geometry import ImageRecord, PoseRecord, invert_transform
from infomap_ros.geometry.records import CameraInfoRecord
from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.localization.localizer import Localizer
from infomap_ros.pipeline.image_synchronizer import ImageSet
from infomap_ros.pipeline.range_estimator import PairRectifier
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.stereo import StereoConfig, StereoRangeSensor

BEFORE, AFTER = 10, 15  # undisturbed views
LIMIT = 55.0


@dataclass(frozen=True)
class Shot:
    """A rectified pair with its true pose."""

    stamp: int
    left: np.ndarray
    right: np.ndarray
    truth: np.ndarray


@dataclass(frozen=True)
class Recording:
    """All pairs of the sequence."""

    shots: list[Shot]
    sensor: StereoRangeSensor


Disturbance = Callable[[list[Shot], int, np.random.Generator], list[Shot]]
"""All shots and where the disturbance begins: the shots from there on."""


def blurred(shots: list[Shot], start: int, rng: np.random.Generator) -> list[Shot]:
    """Both images out of focus for a while."""
    count, sigma = int(rng.integers(3, 12)), float(rng.uniform(1.0, 6.0))
    change = [
        Shot(s.stamp, *(cv2.GaussianBlur(i, (0, 0), sigma) for i in (s.left, s.right)), s.truth)
        for s in shots[start : start + count]
    ]
    return change + shots[start + count : start + count + AFTER]


def moving_object(shots: list[Shot], start: int, rng: np.random.Generator) -> list[Shot]:
    """A textured surface that covers half of the view goes by."""
    count = int(rng.integers(5, 15))
    speed, disparity = rng.uniform(4.0, 15.0) * rng.choice([-1, 1]), float(rng.uniform(20.0, 60.0))
    height, width = shots[0].left.shape
    texture = cv2.GaussianBlur(rng.standard_normal((height, 4 * width)), (0, 0), 2.0)
    texture = np.clip(110.0 + 45.0 * texture / texture.std(), 0, 255).astype(np.float32)
    v, u = np.mgrid[0:height, 0 : width // 2].astype(np.float32)
    change = []
    for index, shot in enumerate(shots[start : start + count]):
        images = [shot.left.copy(), shot.right.copy()]
        for image, shift in zip(images, (0.0, disparity), strict=True):
            place = u + np.float32(1.5 * width + shift - speed * index)
            image[:, : width // 2] = cv2.remap(texture, place, v, cv2.INTER_LINEAR)
        change.append(Shot(shot.stamp, *images, shot.truth))
    return change + shots[start + count : start + count + AFTER]


def lighting_steps(shots: list[Shot], start: int, rng: np.random.Generator) -> list[Shot]:
    """Every few views another brightness and contrast."""
    count, change = int(rng.integers(6, 20)), []
    gain, offset = 1.0, 0.0
    for index, shot in enumerate(shots[start : start + count]):
        if index % 3 == 0:
            gain, offset = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0)))), rng.uniform(0, 40)
        images = [
            np.clip(gain * i.astype(np.float32) + offset, 0, 255).astype(np.uint8)
            for i in (shot.left, shot.right)
        ]
        change.append(Shot(shot.stamp, *images, shot.truth))
    return change + shots[start + count : start + count + AFTER]


def dropped(shots: list[Shot], start: int, rng: np.random.Generator) -> list[Shot]:
    """Views are missing."""
    count = int(rng.integers(2, 12))
    return shots[start + count : start + count + AFTER]


def carried_blind(shots: list[Shot], start: int, rng: np.random.Generator) -> list[Shot]:
    """Black images, and then the camera is somewhere else along its path, or where it was."""
    blind = int(rng.integers(3, 10))
    black = np.zeros_like(shots[0].left)
    dark = [Shot(s.stamp, black, black, s.truth) for s in shots[start : start + blind]]
    jump = int(rng.integers(-BEFORE, 30))
    later = shots[max(0, start + jump) : max(0, start + jump) + AFTER]
    stamp = dark[-1].stamp
    moved = [
        Shot(stamp + 100_000_000 * (i + 1), s.left, s.right, s.truth) for i, s in enumerate(later)
    ]
    return dark + moved


KINDS: dict[str, Disturbance] = {
    "image blur": blurred,
    "moving object on half of the view": moving_object,
    "lighting steps": lighting_steps,
    "dropped views": dropped,
    "carried while blind": carried_blind,
}


def load(path: Path) -> Recording:
    """Rectify all pairs of the bag."""
    pairs = PairRectifier(StereoConfig(), rectify=True)
    infos: dict[str, CameraInfoRecord] = {}
    lefts: dict[int, ImageRecord] = {}
    truth: dict[int, np.ndarray] = {}
    raw: list[tuple[ImageRecord, ImageRecord]] = []
    with BagReader(path) as bag:
        for entry in bag.records():
            record = entry.record
            if isinstance(record, CameraInfoRecord):
                infos[entry.topic] = record
            elif isinstance(record, PoseRecord):
                truth[record.stamp] = record.transform
            elif isinstance(record, ImageRecord) and "left" in entry.topic:
                lefts[record.stamp] = record
            elif isinstance(record, ImageRecord):
                raw.append((lefts.pop(record.stamp), record))
    cameras = infos["/left/camera_info"], infos["/right/camera_info"]
    shots = []
    for pair in raw:
        left, right, sensor = pairs.prepare(ImageSet(pair, cameras))
        shots.append(Shot(pair[0].stamp, left, right, truth[pair[0].stamp]))
    return Recording(shots, sensor)


def is_wrong(result: LocalizedCamera, truth: np.ndarray, T_map_world: np.ndarray) -> bool:
    """Whether a told pose is off by more than its covariance allows."""
    if result.T_map_camera is None or result.covariance is None:
        return False
    true = T_map_world @ truth
    off = true[:3, 3] - result.T_map_camera[:3, 3]
    turn = Rotation.from_matrix(true[:3, :3] @ result.T_map_camera[:3, :3].T).as_rotvec()
    if np.linalg.norm(off) < 0.01 and np.linalg.norm(turn) < 0.01:
        return False
    error = np.r_[off, turn]
    floor = np.diag([1e-3**2] * 3 + [1e-3**2] * 3)
    return bool(error @ np.linalg.solve(result.covariance + floor, error) > LIMIT)


class Gyroscope:
    """Tells turns between views.

    Args:
        seed: of its errors.
    """

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._bias = self._rng.normal(0.0, 0.02, 3)
        self._last: Shot | None = None

    def turn_to(self, shot: Shot) -> np.ndarray | None:
        """``R_before_now`` since the last shot, None at the first."""
        last, self._last = self._last, shot
        if last is None:
            return None
        seconds = 1e-9 * (shot.stamp - last.stamp)
        noise = self._rng.normal(0.0, 5e-4 * np.sqrt(seconds), 3)
        error = Rotation.from_rotvec(self._bias * seconds + noise).as_matrix()
        return last.truth[:3, :3].T @ shot.truth[:3, :3] @ error


def trial(
    recording: Recording, disturb: Disturbance, seed: int, gyroscope: Gyroscope | None = None
) -> tuple[str, float]:
    """Outcome of one trial, and the error of the last told position [m]."""
    rng = np.random.default_rng(seed)
    shots = recording.shots
    start = int(rng.integers(BEFORE, len(shots) - AFTER - 32))
    first = shots[start - BEFORE]
    localizer = Localizer(recording.sensor.rig.left)
    T_map_world = invert_transform(first.truth)
    wrong, result = False, None
    error = float("nan")
    for shot in [*shots[start - BEFORE : start], *disturb(shots, start, rng)]:
        view = StereoView(shot.stamp, shot.left, shot.right, recording.sensor)
        turn = None if gyroscope is None else gyroscope.turn_to(shot)
        result = localizer.locate(view, turn=turn)
        wrong |= is_wrong(result, shot.truth, T_map_world)
        if result.T_map_camera is not None:
            true = T_map_world @ shot.truth
            error = float(np.linalg.norm(true[:3, 3] - result.T_map_camera[:3, 3]))
    assert result is not None
    if wrong:
        return "wrong", error
    outcome = {"tracking": "recovered", "coasting": "honest", "lost": "lost"}
    return outcome.get(result.state, "lost"), error


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=20, help="of each kind")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "bench" / "sequences")
    parser.add_argument("--only", nargs="*", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--gyroscope", action="store_true", help="turns come from a gyroscope")
    arguments = parser.parse_args()
    bag = write_stereo_bag(arguments.work / "room_loop", frames=120, turns=1.2, radius=0.6)
    recording = load(bag)
    print("| disturbance | trials | recovered | honest | lost | wrong | median error [mm] |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    results = {}
    for kind in arguments.only:
        ends = []
        for seed in range(arguments.trials):
            gyroscope = Gyroscope(1000 + seed) if arguments.gyroscope else None
            ends.append(trial(recording, KINDS[kind], seed, gyroscope))
        counts = Counter(outcome for outcome, _ in ends)
        recovered = [error for outcome, error in ends if outcome == "recovered"]
        median = 1e3 * float(np.median(recovered)) if recovered else float("nan")
        numbers = [counts[name] for name in ("recovered", "honest", "lost", "wrong")]
        texts = " | ".join(str(number) for number in numbers)
        print(f"| {kind} | {arguments.trials} | {texts} | {median:.1f} |", flush=True)
        results[kind] = dict(counts) | {"median_error_mm": round(median, 2)}
    print(json.dumps({"benchmark": "localize_robustness", "results": results}))


if __name__ == "__main__":
    main()
