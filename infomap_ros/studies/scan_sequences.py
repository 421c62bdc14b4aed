"""Scans in a row whose poses share errors, as those of a camera in nature do.

standing   the camera rests, and its pose has one error in all images; nothing but the covariance
           of the pose is known
drift      the camera moves slowly, and the error of its pose is a Gauss-Markov process of first
           order with a correlation time of 1 to 30 s
offset     as drift, and the map's frame is misplaced by one error for all scans (of its target)
corrected  as drift, and in the end the poses of keyframes are corrected, with a new error
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import (
    PinholeCamera,
    PoseUncertainty,
    interpolate_transforms,
    make_transform,
    skew,
)
from infomap_ros.geometry.transforms import FloatArray, perturb_transform
from infomap_ros.studies.noisy_scans import (
    AnalyticScene,
    NoisyScan,
    RangeNoise,
    depth_of,
    misplaced,
    random_pose_covariance,
    random_view,
)

CASES = ("standing", "drift", "offset", "corrected")

CAMERA = PinholeCamera(width=96, height=72, fx=80.0, fy=80.0, cx=47.5, cy=35.5)
"""The camera of the sequences."""

PERIOD = 0.1
"""Time between two scans [s]."""

_KEYFRAME = 10  # scans from one keyframe to the next
_COARSE = 3.0  # times as large are the errors before a correction
_SHORTEST, _LONGEST = 1.0, 30.0  # correlation time [s]


@dataclass(frozen=True, eq=False)
class Keyframes:
    """Corrected poses.

    Attributes:
        scans: numbers of the scans, shape (K,).
        poses: T_map_camera, shape (K, 4, 4).
        covariances: shape (K, 6, 6).
    """

    scans: NDArray[np.int64]
    poses: FloatArray
    covariances: FloatArray


@dataclass(frozen=True, eq=False)
class ScanSequence:
    """Scans of one camera, `PERIOD` after each other.

    Attributes:
        scans: in order of time.
        T_world_map: where the map's frame truly is, as far as all scans misplace it alike, (4, 4).
        corrections: what becomes known in the end, None where nothing does.
    """

    scans: list[NoisyScan]
    T_world_map: FloatArray
    corrections: Keyframes | None = None


def simulate_sequence(
    case: str, scene: AnalyticScene, count: int, correlation: float, rng: np.random.Generator
) -> ScanSequence:
    """Take scans of a scene in a row.

    Args:
        case: one of `CASES`.
        scene: what is seen.
        count: number of scans.
        correlation: of the range errors of neighboring pixels, in [0, 1].
        rng: random numbers.
    """
    truth = _resting(scene, count, rng) if case == "standing" else _moving(scene, count, rng)
    noise, covariance = RangeNoise.random(rng, correlation), random_pose_covariance(rng)
    if case == "standing":
        errors = np.repeat(_draw(covariance, rng)[None], count, axis=0)
        uncertainties: list[FloatArray | PoseUncertainty] = [covariance] * count
        return ScanSequence(_take(scene, truth, errors, uncertainties, noise, rng), np.eye(4))
    tau = float(np.exp(rng.uniform(np.log(_SHORTEST), np.log(_LONGEST))))
    clocks = np.arange(count, dtype=np.float64) * (PERIOD / tau)
    if case == "corrected":
        return _corrected(scene, truth, covariance, clocks, noise, rng)
    errors, offset, T_world_map = (
        _gauss_markov(covariance, clocks, rng),
        np.zeros((6, 6)),
        np.eye(4),
    )
    if case == "offset":
        offset = random_pose_covariance(rng)
        T_world_map = perturb_transform(np.eye(4), _draw(offset, rng))
    parts = [
        PoseUncertainty(covariance, offset=_at_camera(offset, pose), clock=float(clock))
        for pose, clock in zip(truth, clocks, strict=True)
    ]
    in_map = np.linalg.inv(T_world_map) @ truth
    scans = _take(scene, truth, errors, parts, noise, rng, in_map)
    return ScanSequence(scans, T_world_map)


def _corrected(
    scene: AnalyticScene,
    truth: FloatArray,
    covariance: FloatArray,
    clocks: FloatArray,
    noise: RangeNoise,
    rng: np.random.Generator,
) -> ScanSequence:
    """Errors before and after are linear between keyframes, as a correction takes them to be."""
    stamps, keys = np.arange(len(truth)), np.arange(0, len(truth), _KEYFRAME)
    keys = np.unique(np.append(keys, len(truth) - 1))
    before = _COARSE * _gauss_markov(covariance, clocks[keys], rng)
    after = _gauss_markov(covariance, clocks[keys], rng)
    between = [np.interp(stamps, keys, column) for column in before.T]
    coarse = _COARSE**2 * covariance
    parts = [PoseUncertainty(coarse, clock=float(clock)) for clock in clocks]
    scans = _take(scene, truth, np.stack(between, axis=1), parts, noise, rng)
    poses = [misplaced(truth[key], error) for key, error in zip(keys, after, strict=True)]
    covariances = np.repeat(covariance[None], len(keys), axis=0)
    return ScanSequence(scans, np.eye(4), Keyframes(keys, np.stack(poses), covariances))


def _take(
    scene: AnalyticScene,
    truth: FloatArray,
    errors: FloatArray,
    uncertainties: list[PoseUncertainty] | list[FloatArray | PoseUncertainty],
    noise: RangeNoise,
    rng: np.random.Generator,
    in_map: FloatArray | None = None,
) -> list[NoisyScan]:
    """Scans from `truth`; the poses in the map that are given are wrong by `errors`."""
    scans, depth, last = [], np.empty(0), None
    poses = truth if in_map is None else in_map
    for pose, placed, error, uncertainty in zip(truth, poses, errors, uncertainties, strict=True):
        if last is None or not np.array_equal(pose, last):
            depth, last = depth_of(scene, pose, CAMERA), pose
        points, covariances = noise.measure(depth, CAMERA, rng)
        scans.append(NoisyScan(points, covariances, misplaced(placed, error), uncertainty))
    return scans


def _resting(scene: AnalyticScene, count: int, rng: np.random.Generator) -> FloatArray:
    return np.repeat(random_view(scene, rng)[None], count, axis=0)


def _moving(scene: AnalyticScene, count: int, rng: np.random.Generator) -> FloatArray:
    """From one view a few decimeters on, turning a little."""
    start = random_view(scene, rng, nearest=0.6)
    motion = make_transform(np.eye(3), rng.uniform(-0.25, 0.25, size=3))
    end = perturb_transform(start @ motion, np.append(np.zeros(3), rng.normal(0.0, 0.1, size=3)))
    shares = np.linspace(0.0, 1.0, count)
    return np.stack([interpolate_transforms(start, end, share) for share in shares])


def _draw(covariance: FloatArray, rng: np.random.Generator) -> FloatArray:
    return np.asarray(rng.multivariate_normal(np.zeros(6), covariance))


def _gauss_markov(
    covariance: FloatArray, clocks: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Errors that correlate by exp(-|difference of their clocks|), shape (n, 6)."""
    errors = [_draw(covariance, rng)]
    for step in np.diff(clocks):
        kept = np.exp(-step)
        errors.append(kept * errors[-1] + np.sqrt(1.0 - kept**2) * _draw(covariance, rng))
    return np.stack(errors)


def _at_camera(offset: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    """Covariance that an error of the map's frame about its origin means for a camera, (6, 6)."""
    lever = np.eye(6)
    lever[:3, 3:] = -skew(T_map_camera[:3, 3])
    return np.asarray(lever @ offset @ lever.T)
