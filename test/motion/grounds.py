"""Terrains made from formulas, and the rover on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from infomap_ros.mapping.terrain.measures import largest_steps, plane_misfits
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base import stance as kernels
from infomap_ros.motion.base.vehicle import Vehicle, VehicleConfig
from infomap_ros.motion.robot.robot_model import RobotModel

ROVER = Path(__file__).resolve().parents[2] / "config" / "rover.urdf"
FOLDED = {"arm_shoulder_joint": -1.2, "arm_elbow_joint": 2.4}
CELL = 0.05

Height = Callable[[np.ndarray, np.ndarray], np.ndarray]


def ground(
    height: Height,
    half: float = 2.0,
    overhead: Height | None = None,
    seen: Height | None = None,
    near: tuple[float, float, float] = (0.0, 0.0, 0.1),
    cell: float = CELL,
    sigma: float = 0.0,
) -> Terrain:
    """A square of ground about the origin; NaN heights are unknown, all above is open and seen.

    Args:
        height: of x and y [m].
        half: half its edge [m].
        overhead: of x and y, lower end of obstacles [m].
        seen: of x and y, end of what was seen [m].
        near: where the robot is.
        cell: edge of a cell [m].
        sigma: standard deviation of the heights [m].
    """
    count = round(2.0 * half / cell)
    x, y = (np.indices((count, count)) + 0.5) * cell - half
    everywhere = np.zeros((count, count))
    heights = height(x, y) + everywhere
    steps, roughness = np.empty_like(heights), np.empty_like(heights)
    largest_steps(heights, everywhere + sigma, cell, steps)
    plane_misfits(heights, 2, 0.1, roughness)
    above = everywhere + (np.inf if overhead is None else overhead(x, y))
    known = everywhere + (10.0 if seen is None else seen(x, y))
    return Terrain(
        heights=heights.astype(np.float32),
        sigma=np.full(heights.shape, sigma, np.float32),
        roughness=roughness.astype(np.float32),
        step=steps.astype(np.float32),
        floor=np.where(np.isnan(heights), -5.0, heights).astype(np.float32),
        overhead=above.astype(np.float32),
        seen=known.astype(np.float32),
        origin=(-half, -half),
        resolution=cell,
        near=near,
    )


def rough(rng: np.random.Generator, size: float, half: float = 2.0) -> Height:
    """Random waves of about `size` [m] amplitude, 0.4 to 2 m long."""
    directions = rng.uniform(0.0, 2.0 * np.pi, 12)
    lengths, phases = rng.uniform(0.4, 2.0, 12), rng.uniform(0.0, 2.0 * np.pi, 12)
    heights = size * lengths / lengths.max() / np.sqrt(6.0)

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        along = np.cos(directions) * x[..., None] + np.sin(directions) * y[..., None]
        return (heights * np.sin(2.0 * np.pi * along / lengths + phases)).sum(axis=-1)

    return height


def plane(slope_x: float, slope_y: float, level: float = 0.0) -> Height:
    """Inclined ground."""
    return lambda x, y: level + slope_x * x + slope_y * y


def rover_model() -> RobotModel:
    """The rover of this repository."""
    return RobotModel.from_urdf(ROVER, camera_frame="left_camera_optical_frame")


def rover(**config: object) -> Vehicle:
    """The rover with its arm folded."""
    return Vehicle.from_robot(rover_model(), VehicleConfig(**config), FOLDED)


@dataclass(frozen=True)
class Stance:
    """How a vehicle stands at one place, with its measures, NaN where they were not reached."""

    T_map_base: np.ndarray
    ok: bool
    reason: str
    tip_margin: float
    slope: float
    step: float
    roughness: float
    clearance: float


def stance_of(vehicle, terrain, x, y, yaw, q=None):
    batch = vehicle.stances(terrain, [[x, y, yaw]], q)
    measures = batch.measures[0]
    return Stance(
        batch.T_map_base[0],
        bool(batch.ok[0]),
        vehicle.refusal(terrain, np.array([x, y, yaw], dtype=float), q),
        float(measures[kernels.TIP]),
        float(measures[kernels.SLOPE]),
        float(measures[kernels.STEP]),
        float(measures[kernels.ROUGHNESS]),
        float(measures[kernels.CLEARANCE]),
    )
