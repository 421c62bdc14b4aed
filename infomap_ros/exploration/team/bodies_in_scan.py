"""Bodies of teammates placed for a scan, and which of its points lie on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry import Cylinder, PlacedSolid, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.team.agents import Agent


@dataclass(frozen=True, eq=False)
class BodyInScan:
    """A teammate's body.

    Attributes:
        robot: its id.
        solids: placed in the camera's frame.
        margin: by which they are to be grown [m].
        is_sure: whether it is known where it was at the scan's stamp.
        ground: (n, d), shape (4,): what lies at p with ``n . p < d`` [m] is its ground;
            None where it is of no matter.
    """

    robot: int
    solids: Sequence[PlacedSolid]
    margin: float
    is_sure: bool
    ground: FloatArray | None = None


def on_bodies(
    points: ArrayLike,
    covariances: ArrayLike | None,
    bodies: Sequence[BodyInScan],
    config: BodyFilterConfig,
) -> NDArray[np.bool_]:
    """Mark the points of a scan that may lie on one of several bodies.

    Args:
        points: shape (..., 3), camera frame [m].
        covariances: as `mapping.scans.body.body_mask` takes them.
        bodies: placed in the camera's frame, each with its margin.
        config: how points' errors count.
    """
    mask = np.zeros(np.shape(points)[:-1], np.bool_)
    for body in bodies:
        grown = replace(config, margin=body.margin)
        mask |= body_mask(points, covariances, body.solids, grown)
    return mask


def largest_variance(covariance: FloatArray, lever: float) -> float:
    """Largest variance of a point at a lever [m] from a pose's origin, from above [m^2]."""
    position = np.linalg.eigvalsh(covariance[:3, :3])[-1]
    rotation = np.linalg.eigvalsh(covariance[3:, 3:])[-1]
    # Whatever the two have to do with each other, the deviations add at the most.
    return float((np.sqrt(max(position, 0.0)) + lever * np.sqrt(max(rotation, 0.0))) ** 2)


def cylinder_about(agent: Agent, growth: float) -> PlacedSolid:
    """The cylinder about a robot's body, grown, in the frame of its base."""
    height = max(agent.top - agent.bottom, 0.01) + 2.0 * growth
    middle = make_transform(np.eye(3), (0.0, 0.0, 0.5 * (agent.top + agent.bottom)))
    return PlacedSolid(Cylinder(agent.radius + max(growth, 0.01), height), middle, "robot")
