"""Postures of the arm whose camera is at a view, or near to it."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.inverse_kinematics import IkConfig, solve_ik_batch
from infomap_ros.motion.whole_body import WholeBody

_SOLVED = 64  # views about the wanted one for which inverse kinematics is solved
_SAMPLED = 400  # random postures that are nearest to it
_WITHIN = 0.8  # share of the tolerances within which these views lie: the rest is for the solver


def postures_near(
    whole: WholeBody,
    T_base_camera: FloatArray,
    position_tolerance: float,
    angle_tolerance: float,
    start: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Postures by how far the camera is from a view; nothing is said of what they touch.

    An arm reaches most views in few postures only, but views within the tolerances in many more.

    Args:
        whole: the robot.
        T_base_camera: the view, shape (4, 4).
        position_tolerance: [m].
        angle_tolerance: of the viewing direction [rad]; the roll is free.
        start: a posture, shape (n,), like which some of the solutions are to be.

    Returns:
        Postures, shape (M, n) [rad or m], the nearest first; and their errors, shape (M,): at most
        1 within both tolerances, else more.
    """
    postures, view = whole.postures, T_base_camera
    flat, azimuths = np.cos(postures.steepness), postures.azimuths
    directions = np.column_stack(
        [flat * np.cos(azimuths), flat * np.sin(azimuths), np.sin(postures.steepness)]
    )
    errors = _errors(postures.positions, directions, view, position_tolerance, angle_tolerance)
    nearest = postures.q[np.argsort(errors)[:_SAMPLED]]
    views = _views_about(view, _WITHIN * position_tolerance, _WITHIN * angle_tolerance)
    config = IkConfig(
        position_tolerance=0.1 * position_tolerance,
        rotation_tolerance=0.1 * angle_tolerance,
        restarts=0,
    )
    starts = np.resize(nearest, (_SOLVED, nearest.shape[1]))
    if start is not None:
        starts[::4] = start
    solved = solve_ik_batch(
        whole.chain, views, direction_only=True, q_start=starts, config=config
    ).q
    found = np.concatenate([solved, nearest])
    cameras = whole.chain.camera_pose(found)
    errors = _errors(
        cameras[:, :3, 3], cameras[:, :3, 2], view, position_tolerance, angle_tolerance
    )
    order = np.argsort(errors, kind="stable")
    return found[order], errors[order]


def _errors(
    positions: FloatArray, directions: FloatArray, view: FloatArray, away: float, turned: float
) -> FloatArray:
    """Errors of position and direction as shares of their tolerances, shape (M,).

    The larger one where that is at most 1. Beside the tolerances both count: a camera that is a
    little nearer shows less of what was to be seen where it looks elsewhere.
    """
    distances = np.linalg.norm(positions - view[:3, 3], axis=1) / away
    angles = np.arccos(np.clip(directions @ view[:3, 2], -1.0, 1.0)) / turned
    larger = np.maximum(distances, angles)
    return np.where(larger <= 1.0, larger, np.hypot(distances, angles))


def _views_about(view: FloatArray, away: float, turned: float) -> FloatArray:
    """Views at most so far from one, itself first, shape (`_SOLVED`, 4, 4); always the same."""
    rng, views = np.random.default_rng(0), np.tile(view, (_SOLVED, 1, 1))
    offsets = rng.normal(size=(_SOLVED, 3))
    offsets *= away * rng.random((_SOLVED, 1)) / np.linalg.norm(offsets, axis=1, keepdims=True)
    angles, sides = turned * rng.random(_SOLVED), 2.0 * np.pi * rng.random(_SOLVED)
    offsets[0], angles[0] = 0.0, 0.0
    across, upward, ahead = view[:3, 0], view[:3, 1], view[:3, 2]
    axes = np.outer(np.cos(sides), across) + np.outer(np.sin(sides), upward)
    turned_ahead = np.outer(np.cos(angles), ahead) + np.sin(angles)[:, None] * axes
    side = np.cross(upward, turned_ahead)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    views[:, :3, 0], views[:, :3, 1] = side, np.cross(turned_ahead, side)
    views[:, :3, 2] = turned_ahead
    views[:, :3, 3] += offsets
    return views
