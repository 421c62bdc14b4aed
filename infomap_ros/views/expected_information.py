"""How much a camera pose is expected to tell about the map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.workers import Workers
from infomap_ros.views.field import (
    EMPTY,
    SOLID,
    VisibleField,
    code_probabilities,
    is_known_code,
    visible_field,
)
from infomap_ros.views.information_config import InformationConfig
from infomap_ros.views.observation_value import voxel_bits
from infomap_ros.views.predicted_field import with_predictions
from infomap_ros.views.ray_kernels import view_bits
from infomap_ros.views.rays import camera_rays, checked_poses, checked_reach

_LEAST_STEPS = 64


@dataclass(frozen=True, eq=False)
class GainTable:
    """What the steps of a ray tell, by the code of the voxel in which they are.

    Attributes:
        gains: bits per steradian, shape (steps, codes), float32.
        before: sum over the steps before, shape (steps + 1, codes), float32.
        clear: probability that a step's way does not hide what is behind it, shape (codes,).
        step: length of a step [voxels].
    """

    gains: NDArray[np.float32]
    before: NDArray[np.float32]
    clear: FloatArray
    step: float


def gain_table(m: VoxelMap, max_range: float, config: InformationConfig) -> GainTable:
    """Gains for a map's voxel size and evidence.

    Args:
        m: the map.
        max_range: [m].
        config: of the sensor.
    """
    reach = max_range / m.config.voxel_size
    steps = max(math.ceil(reach), _LEAST_STEPS)
    edges = np.linspace(0.0, reach, steps + 1)
    middle = 0.5 * (edges[:-1] + edges[1:]) * m.config.voxel_size
    p = code_probabilities(config.certain_probability)
    bits = voxel_bits(p, middle[:, None], m.config, config)
    bits[:, [EMPTY, SOLID]] = 0.0
    bits[middle < config.min_range] = 0.0
    gains = bits * np.diff(edges**3)[:, None] / 3.0
    before = np.concatenate([np.zeros((1, len(p))), np.cumsum(gains, axis=0)])
    step = reach / steps
    clear = np.where(p > 0.5, (1.0 - p) ** step, 1.0)
    clear[~is_known_code(config.certain_probability)] *= (1.0 - config.unknown_occlusion) ** (
        1.0 / steps
    )
    return GainTable(gains.astype(np.float32), before.astype(np.float32), clear, step)


def field_around(
    m: VoxelMap, positions: FloatArray, max_range: float, config: InformationConfig
) -> VisibleField:
    """The part of a map that can be seen from positions, shape (M, 3) [m], within `max_range`."""
    low, high = positions.min(axis=0) - max_range, positions.max(axis=0) + max_range
    field = visible_field(m, low, high, config.certain_probability)
    return (
        with_predictions(field, m, config.certain_probability) if config.predict_unknown else field
    )


def checked_region(region: ArrayLike | None) -> FloatArray:
    """Corners (low, high) of a region, shape (2, 3) [m]; all of space without one.

    Raises:
        InvalidInputError: it is not a box (low, high), shape (2, 3).
    """
    if region is None:
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    box = float_array(region, "region")
    if box.shape != (2, 3) or np.isnan(box).any() or (box[1] < box[0]).any():
        raise InvalidInputError("region", f"is {box.tolist()}, expected (low, high) corners")
    return box


@cache
def workers_of(threads: int) -> Workers:
    """Threads that share the rays; kept, because starting them costs more than many a view."""
    return Workers(threads)


def expected_entropy_reduction(
    m: VoxelMap,
    poses: FloatArray,
    camera: PinholeCamera,
    max_range: float,
    config: InformationConfig,
    region: ArrayLike | None = None,
    threads: int = 1,
) -> FloatArray:
    """Bits that one scan from each pose is expected to take off the map's entropy, shape (M,).

    The sum over the voxels in view of what one observation of each is expected to tell, see
    `views.observation_value`, times the probability that known obstacles before it do not hide it.
    An unknown voxel has 1 bit to lose, as `VoxelMap.entropy_bits` counts it. It is 0 if everything
    in view is known and empty; falls when the view is occluded; grows with every unknown voxel in
    view; and grows where known voxels are nearer to 0.5: the intent that Sujan and Dubowsky
    (2005, doi:10.1177/0278364905051774) state for eqs. (7) to (9).

    Bits depend on the voxel size, as entropy does; bits times the volume of a voxel is a volume of
    unknown space that does not.
    """
    if len(poses) == 0:
        return np.zeros(0)
    field = field_around(m, poses[:, :3, 3], max_range, config)
    table = gain_table(m, max_range, config)
    rays, angles = camera_rays(camera, config.ray_spacing)
    scaled = poses.copy()
    scaled[:, :3, 3] = field.relative(poses[:, :3, 3])
    box = field.relative(checked_region(region))
    parts = np.zeros((threads, len(poses)))

    def cast(part: int, first: int, last: int) -> None:
        view_bits(
            scaled, rays[first:last], angles[first:last], box, field.directory, field.codes,
            table.gains, table.before, table.clear, table.step, config.least_visibility,
            parts[part],
        )  # fmt: skip

    workers_of(threads).run(cast, len(rays))
    return np.asarray(parts.sum(axis=0))


def expected_information(
    m: VoxelMap,
    poses: ArrayLike,
    camera: PinholeCamera,
    max_range: float,
    metric: str = "expected_entropy_reduction",
    config: InformationConfig | None = None,
    region: ArrayLike | None = None,
    threads: int = 1,
) -> FloatArray:
    """How much a scan from each camera pose is expected to tell.

    Args:
        m: the map.
        poses: T_map_camera of the optical frame, shape (M, 4, 4).
        camera: opening of the camera; its number of pixels does not matter.
        max_range: nothing farther is measured [m].
        metric: one of `METRICS`, which says its unit; the default is in bits.
        config: rays and sensor.
        region: box (low, high), shape (2, 3), map frame [m]: only voxels in it count.
        threads: that share the rays.

    Returns:
        Shape (M,).

    Raises:
        InvalidInputError: an argument has a wrong shape or impossible content, or there is no such
            metric.
    """
    if metric not in METRICS:
        raise InvalidInputError("metric", f"'{metric}' is none of {', '.join(METRICS)}")
    transforms = checked_poses(poses)
    reach = checked_reach(transforms[:, :3, 3], max_range, m.config.voxel_size)
    return METRICS[metric](
        m, transforms, camera, reach, config or InformationConfig(), region, threads
    )


METRICS = {"expected_entropy_reduction": expected_entropy_reduction}
"""Metrics by name."""
