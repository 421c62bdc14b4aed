"""Arms that the tests of inverse kinematics move."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from infomap_ros.motion.robot.chain import KinematicChain, fill_jacobian, place_chain
from infomap_ros.motion.robot.robot_model import RobotModel

REPOSITORY = Path(__file__).resolve().parents[2]


def serial_arm(axes: str, links: list[float], limits: list[tuple[float, float]]) -> RobotModel:
    """An upright arm: joint k turns about axis k ("x", "y", "z"; "s" slides along z).

    Each joint stands a link above the one before; limits of (-inf, inf) make it continuous. The
    camera looks along the last link.
    """
    parts = ['<link name="base"/>']
    parent, height = "base", 0.0
    for k, (axis, length, (lower, upper)) in enumerate(zip(axes, links, limits, strict=True)):
        kind = "prismatic" if axis == "s" else "continuous" if np.isinf(upper) else "revolute"
        vector = {"x": "1 0 0", "y": "0 1 0"}.get(axis, "0 0 1")
        bounds = "" if np.isinf(upper) else f'lower="{lower}" upper="{upper}"'
        parts.append(
            f'<link name="link{k}"/><joint name="joint{k}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="link{k}"/><origin xyz="0 0 {height}"/><axis xyz="{vector}"/>'
            f'<limit {bounds} effort="1" velocity="{1.0 + 0.1 * k}"/></joint>'
        )
        parent, height = f"link{k}", length
    parts.append(
        f'<link name="camera"/><joint name="mount" type="fixed"><parent link="{parent}"/>'
        f'<child link="camera"/><origin xyz="0.01 0.02 {height}" rpy="0 0 0.3"/></joint>'
    )
    return RobotModel.from_urdf(f'<robot name="serial">{"".join(parts)}</robot>', "camera")


def seven() -> RobotModel:
    """Seven joints, one of them continuous."""
    limits = [(-np.inf, np.inf), (-1.8, 1.8), (-2.9, 2.9), (-2.5, 0.1), (-2.9, 2.9)]
    return serial_arm(
        "zyzyzyz", [0.3, 0.2, 0.3, 0.2, 0.3, 0.08, 0.1], [*limits, (-1.5, 2.0), (-2.9, 2.9)]
    )


def six_wide() -> RobotModel:
    """Six joints that turn up to two turns."""
    return serial_arm("zyyzyz", [0.1, 0.4, 0.4, 0.1, 0.1, 0.1], [(-6.28, 6.28)] * 6)


def five_with_slide() -> RobotModel:
    """Five joints, the first of which is a lift."""
    limits = [(0.2, 1.0), (-2.0, 2.0), (-2.0, 2.0), (-2.0, 2.0), (-3.0, 3.0)]
    return serial_arm("szyyx", [0.0, 0.2, 0.3, 0.3, 0.1], limits)


def rover() -> RobotModel:
    """Four joints: pan, and three that pitch."""
    return RobotModel.from_urdf(REPOSITORY / "config/rover.urdf", "left_camera_optical_frame")


def planar() -> RobotModel:
    """Two links of 0.5 and 0.3 m in the x-z plane; elbow either way."""
    return serial_arm("yy", [0.5, 0.3], [(-3.0, 3.0), (-2.5, 2.5)])


ARMS = {"7": seven, "6": six_wide, "5": five_with_slide, "4": rover}


def random_positions(chain: KinematicChain, rng: np.random.Generator, count: int) -> np.ndarray:
    """Positions within the limits; continuous joints within a turn, shape (count, n)."""
    low = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    high = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    return rng.uniform(low, high, size=(count, len(chain)))


def placed_cameras(robot: RobotModel, qs: np.ndarray) -> np.ndarray:
    """``T_base_camera`` for each row of positions, by Pinocchio, shape (N, 4, 4)."""
    return np.array(
        [robot.forward_kinematics(robot.arm.by_name(q), robot.camera_frame) for q in qs]
    )


def errors(robot: RobotModel, qs: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, ...]:
    """Distances [m], angles between the poses and between the viewing directions [rad]."""
    cameras = placed_cameras(robot, qs)
    distances = np.linalg.norm(cameras[:, :3, 3] - targets[:, :3, 3], axis=1)
    turned = cameras[:, :3, :3].transpose(0, 2, 1) @ targets[:, :3, :3]
    half = np.linalg.norm(turned - np.eye(3), axis=(1, 2)) / np.sqrt(8.0)
    apart = np.linalg.norm(cameras[:, :3, 2] - targets[:, :3, 2], axis=1)
    return (
        distances,
        2.0 * np.arcsin(half.clip(max=1.0)),
        2.0 * np.arcsin((0.5 * apart).clip(max=1)),
    )


def jacobian_of(chain: KinematicChain, q: np.ndarray) -> np.ndarray:
    """Of the camera's position above its rotation, shape (6, n), as inverse kinematics has it."""
    arrays = chain.arrays
    places = np.empty((len(arrays.columns) + 1, 3, 4))
    place_chain(arrays, np.asarray(q), places)
    jacobian = np.empty((6, len(chain)))
    fill_jacobian(arrays, places, jacobian)
    return jacobian
