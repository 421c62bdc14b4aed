"""A camera that walks past fiducials: true poses, and what the camera measures, without images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    PinholeCamera,
    invert_transform,
    make_transform,
    transform_points,
)
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations

CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)
_CANDIDATES = 12  # places of which a new fiducial takes that farthest from the others
_BORDER = 10.0  # [px]


@dataclass(frozen=True)
class WalkConfig:
    """The camera's noise and steps.

    Raises:
        ConfigError: a value is out of its range.
    """

    steps: int = parameter(50, "Steps of the camera.", low=2, high=10000)
    step: float = parameter(0.02, "Length of a step.", unit="m", low=0.0, high=1.0)
    wander: float = parameter(
        0.6,
        "Share of a step's direction that is new; the rest is the last step's.",
        low=0.0,
        high=1.0,
    )
    turn: float = parameter(
        0.01,
        "Standard deviation of the turn about each axis in a step.",
        unit="rad",
        low=0.0,
        high=1.0,
    )
    baseline: float = parameter(0.12, "Of the stereo pair.", unit="m", low=0.01, high=2.0)
    pixel_sigma: float = parameter(
        0.3, "Noise of a fiducial's place in the left image.", unit="px", low=0.01, high=10.0
    )
    disparity_sigma: float = parameter(
        0.3, "Noise of its disparity.", unit="px", low=0.01, high=10.0
    )

    def __post_init__(self) -> None:
        check_config(self)

    @property
    def inverse_depth_sigma(self) -> float:
        """Noise of 1/z [1/m]."""
        return self.disparity_sigma / (CAMERA.fx * self.baseline)


@dataclass(frozen=True, eq=False)
class WalkFrame:
    """What is measured at one step.

    Attributes:
        T_map_camera: true pose, shape (4, 4); the first is the identity.
        observations: of the fiducials followed from the last step and of new ones.
        followed: ids that can be seen at the next step too, shape (n,).
    """

    T_map_camera: FloatArray
    observations: FiducialObservations
    followed: NDArray[np.int64]


def walk(
    config: WalkConfig, count: int, mean_distance: float, rng: np.random.Generator
) -> Iterator[WalkFrame]:
    """Frames of one walk.

    The camera explores: steps of one length in directions that change at random, and little turns.
    Every fiducial is followed while it is in view; one that will have left the view at the next
    step is replaced in time, by one that was followed before where it is in view, else by a new
    one.

    Args:
        config: noise and steps.
        count: fiducials followed from every step to the next.
        mean_distance: of new fiducials along the optical axis [m]; they lie within 30 % of it.
        rng: of everything.

    Yields:
        `config.steps` + 1 frames.
    """
    pose, direction = np.eye(4), _random_direction(rng)
    known: dict[int, FloatArray] = {}
    followed: list[int] = []
    for _ in range(config.steps + 1):
        direction = (1.0 - config.wander) * direction + config.wander * _random_direction(rng)
        direction /= np.linalg.norm(direction)
        turn = Rotation.from_rotvec(rng.normal(0.0, config.turn, 3)).as_matrix()
        following = make_transform(pose[:3, :3] @ turn, pose[:3, 3] + config.step * direction)
        views = (pose, following)
        measured = set(followed)
        followed = [number for number in followed if _in_view(known[number], following)]
        again = [n for n in known if n not in followed and _in_both(known[n], views)]
        followed += again[: count - len(followed)]
        while len(followed) < count:
            others = [known[number] for number in followed]
            known[len(known)] = _new_point(views, mean_distance, others, rng)
            followed.append(len(known) - 1)
        points = {number: known[number] for number in sorted(measured | set(followed))}
        yield WalkFrame(pose, _observe(points, pose, config, rng), np.array(followed, np.int64))
        pose = following


def _random_direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _in_view(point: FloatArray, pose: FloatArray) -> bool:
    inside = transform_points(invert_transform(pose), point)
    if inside[2] <= 0.05:
        return False
    u, v = CAMERA.project(inside)
    return bool(_BORDER <= u <= CAMERA.width - _BORDER and _BORDER <= v <= CAMERA.height - _BORDER)


def _in_both(point: FloatArray, views: tuple[FloatArray, FloatArray]) -> bool:
    return all(_in_view(point, view) for view in views)


def _new_point(
    views: tuple[FloatArray, FloatArray],
    mean_distance: float,
    others: list[FloatArray],
    rng: np.random.Generator,
) -> FloatArray:
    """A point in view now and at the next step, apart from the others, shape (3,)."""
    candidates: list[FloatArray] = []
    # One depth for all, or points far from the others would also be farther from the camera.
    depth = mean_distance * rng.uniform(0.7, 1.3)
    while len(candidates) < _CANDIDATES:
        u, v = rng.uniform(0, CAMERA.width), rng.uniform(0, CAMERA.height)
        ray = np.array([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1.0])
        point = transform_points(views[0], depth * ray)
        if _in_both(point, views):
            candidates.append(point)
    if not others:
        return candidates[0]
    apart = np.linalg.norm(np.array(candidates)[:, None] - np.array(others)[None], axis=2)
    return candidates[int(np.argmax(apart.min(axis=1)))]


def _observe(
    points: dict[int, FloatArray], pose: FloatArray, config: WalkConfig, rng: np.random.Generator
) -> FiducialObservations:
    """Measurements of points, with noise."""
    ids = np.array(list(points), np.int64)
    inside = transform_points(invert_transform(pose), np.array(list(points.values())))
    count, sigma = len(ids), config.inverse_depth_sigma
    return FiducialObservations(
        ids,
        CAMERA.project(inside) + rng.normal(0.0, config.pixel_sigma, (count, 2)),
        np.full(count, config.pixel_sigma),
        1.0 / inside[:, 2] + rng.normal(0.0, sigma, count),
        np.full(count, sigma),
    )
