"""A posture in which an arm holds its camera level and looks ahead: where a simulation starts.

A posture for the arms that do not carry the camera: over the base, out of the way.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial

import numpy as np

from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.motion.arm.arm_path import QUICK_SEARCH, plan_arm_path
from infomap_ros.motion.arm.arm_postures import driving_posture, least_posture
from infomap_ros.motion.base.standing_ground import ClearStart
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.checker import NearSpace
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import body_extent, robot_bottom
from infomap_ros.motion.whole_body import ReachingConfig
from infomap_ros.simulation.robots.camera_parts import find_arm_ends, link_extents

_HEIGHT = 0.9  # of the camera above the ground: over tables, and walls are seen well [m]
_DOWN = 0.15  # [rad] that it looks down
_TURN, _ROLL, _LIFT, _SIDE, _AHEAD = 6.0, 1.5, 1.0, 2.0, 2.0  # weights: 1/rad, 1/rad, 1/m ...
_FOLDING = (0.08, 0.3, 1.2)  # weights of the distance to the posture in which it drives [1/rad]
_OVER_BASE = 0.3  # from the origin of the base to where a camera ahead costs nothing [m]
_IN_VIEW = 20.0  # cost of a body that fills the image
_HALF_VIEW = 0.65  # [rad]
_FAR = 1.2  # [m]; what of the body is farther away hides little


def home_posture(robot: RobotModel, others: Mapping[str, float] | None = None) -> FloatArray:
    """Find a posture to start with, always the same for the same robot.

    The camera looks ahead along x of the base and 0.15 rad down, upright, about 0.9 m above the
    ground and over the middle of the base, with little of the body in its view, not far from the
    posture in which the robot drives; nothing touches. Where the arm cannot be folded for the drive
    within the space that is declared clear about a start, the distance there counts for more.

    Args:
        robot: with its camera.
        others: where joints stand that are not of the arm [rad or m]; at rest where not given.

    Returns:
        Positions of the arm, shape (n,) [rad or m].

    Raises:
        RobotModelError: no posture without contact was found.
    """
    body = CollisionBody.from_robot(robot, joint_positions=others)
    bottom, folded = robot_bottom(robot), driving_posture(body)
    ahead = np.array([np.cos(_DOWN), 0.0, -np.sin(_DOWN)])

    def cost(q: FloatArray, weight: float) -> float:
        camera = robot.arm.camera_pose(q)
        across, forward = camera[:3, 0], camera[:3, 2]
        turn = float(np.arccos(np.clip(forward @ ahead, -1.0, 1.0)))
        roll = float(np.arccos(np.clip(-across[1], -1.0, 1.0)))
        lift = abs(float(camera[2, 3]) - bottom - _HEIGHT)
        seen = _share_in_view(camera, body.spheres(q, np.eye(4)))
        side = abs(float(camera[1, 3]))
        far = max(float(camera[0, 3]) - _OVER_BASE, 0.0)
        aside = _LIFT * lift + _SIDE * side + _AHEAD * far
        folding = weight * float(np.abs(q - folded).sum())
        return _TURN * turn + _ROLL * roll + aside + _IN_VIEW * seen + folding

    postures = (least_posture(body, partial(cost, weight=weight)) for weight in _FOLDING)
    found = next(postures)
    for nearer in postures:
        if _can_fold(body, found, folded, others or {}):
            break
        found = nearer
    return found


def _can_fold(
    body: CollisionBody, q: FloatArray, folded: FloatArray, others: Mapping[str, float]
) -> bool:
    """Whether the arm gets from one posture to another where only the start is known to be free."""
    robot, at = body.robot, np.eye(4)
    rest = {joint.name: joint.rest for joint in robot.joints}
    joints = {**rest, **others, **body.chain.by_name(q)}
    clear = ClearStart(at, ViewPlannerConfig().start_clearance).space(robot)
    reach = clear.solid.bounding_radius + body_extent(robot, joints)[0]
    near = NearSpace(
        VoxelMap(VoxelMapConfig()), body, at, joints, reach, ReachingConfig.clear_body, (clear,)
    )
    return plan_arm_path(near.checker_at(at), q, folded, at, QUICK_SEARCH).converged


def _share_in_view(camera: FloatArray, spheres: FloatArray) -> float:
    """Share of the image that the robot's spheres, shape (S, 4) [m], hide at the most."""
    local = (spheres[:, :3] - camera[:3, 3]) @ camera[:3, :3]
    distance = np.linalg.norm(local, axis=1)
    near = (local[:, 2] > 0.0) & (distance < _FAR) & (distance > spheres[:, 3])
    if not near.any():
        return 0.0
    angle = np.arctan2(np.hypot(local[near, 0], local[near, 1]), local[near, 2])
    size = np.arcsin(np.clip(spheres[near, 3] / distance[near], 0.0, 1.0))
    inside = np.clip((_HALF_VIEW + size - angle) / (2.0 * _HALF_VIEW), 0.0, 1.0)
    return float(np.max(inside * np.minimum(size / _HALF_VIEW, 1.0)))


_STRETCHED = 0.1  # [m] beyond the base from which an arm is in the way


def tucked_arms(robot: RobotModel, wheels: Collection[str]) -> dict[str, float]:
    """Positions in which further arms hinder neither the base nor the arm of the camera.

    An arm that reaches beyond the base where its joints rest as near zero as they can gets the
    posture that an arm drives in. All joints at rest, it touches nothing of the robot there.

    Args:
        robot: with its camera.
        wheels: names of the joints of its wheels.

    Returns:
        Positions by joint [rad or m]; empty where no further arm is stretched out.

    Raises:
        RobotModelError: an arm touches the robot in every posture.
    """
    found: dict[str, float] = {}
    taken = {*robot.arm.joint_names, *wheels}
    for end in find_arm_ends(robot):
        joints = tuple(name for name in end.joints if name not in taken)
        is_apart = 2 * len(joints) > len(end.joints)  # no hand of an arm that is posed already
        if not is_apart or _overhang(robot, joints) < _STRETCHED:
            continue
        arm = RobotModel(robot.mechanism, robot.shapes, robot.base_frame, end.link, joints)
        body = CollisionBody.from_robot(arm, joint_positions=found)
        found |= body.chain.by_name(np.round(driving_posture(body), 3) + 0.0)
        taken |= set(joints)
    return found


def _overhang(robot: RobotModel, joints: Collection[str]) -> float:
    """How far what joints move reaches beyond what no joint moves, seen from above, at rest [m]."""
    moved, still = list[FloatArray](), [np.zeros((2, 2))]
    numbers = {int(robot.model.getJointId(name)) for name in joints}
    joint_of = {shape.link: shape.joint for shape in robot.shapes}
    for link, extent in link_extents(robot).items():
        above = {int(index) for index in robot.model.supports[joint_of[link]]}
        if above & numbers:
            moved.append(np.array(extent)[:, :2])
        elif joint_of[link] == 0:
            still.append(np.array(extent)[:, :2])
    if not moved:
        return 0.0
    arm, base = np.concatenate(moved), np.concatenate(still)
    return float(np.maximum(arm - base.max(axis=0), base.min(axis=0) - arm).max())
