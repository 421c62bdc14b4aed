"""A posture for the arms that do not carry the camera: over the base, out of the way."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.arm_postures import driving_posture
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.robots.camera_parts import find_arm_ends
from infomap_ros.simulation.robots.wheel_parts import link_extents

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
