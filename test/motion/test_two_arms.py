"""A second arm: the driving posture is as narrow as without it, and what it hinders is told."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.motion.arm.arm_postures import driving_posture
from infomap_ros.motion.base.standing_ground import ClearStart
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import solid_extent
from infomap_ros.motion.whole_body import ReachingConfig, WholeBody

from .two_arms import CAMERA, HALF_BASE, RIGHT, two_armed_urdf, two_arms

TUCKED = dict(zip(RIGHT, (2.5, 2.6), strict=True))


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return two_arms()


def overhang(robot: RobotModel, joints: dict[str, float], side: str) -> float:
    """How far an arm's solids, placed by Pinocchio, reach beyond the base [m]."""
    extents = [
        solid_extent(solid)
        for solid in robot.solids_in("base_link", joints)
        if solid.name.startswith(side)
    ]
    return max(float(np.abs(np.array(extent)[:, :2]).max()) for extent in extents) - HALF_BASE


def at_rest(robot: RobotModel) -> dict[str, float]:
    return {joint.name: joint.rest for joint in robot.joints}


def test_the_driving_posture_is_as_narrow_whatever_the_other_arm_does(robot: RobotModel) -> None:
    for others in ({}, TUCKED):
        body = CollisionBody.from_robot(robot, joint_positions=others)
        q = body.chain.by_name(driving_posture(body))
        joints = {**at_rest(robot), **others, **q}
        assert overhang(robot, joints, "left") < 0.15
    assert overhang(robot, at_rest(robot), "right") > 0.6


def test_what_keeps_the_base_in_its_place_is_named(robot: RobotModel) -> None:
    """Nothing is known but the place of the start: the stretched arm cannot turn in it."""
    start, view = ClearStart(np.eye(4), 0.5), make_transform(np.eye(3), (4.0, 0.0, 0.8))
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    body = CollisionBody.from_robot(robot)
    folded = at_rest(robot) | body.chain.by_name(driving_posture(body))
    reach = WholeBodyReach(robot, voxel_map, np.eye(4), folded, start=start)
    reason = reach.may_reach(view)[0]
    assert reason.startswith("the base cannot drive: it gets 0.")
    assert "right_lower enters space that was never seen at (" in reason
    free = WholeBodyReach(robot, voxel_map, np.eye(4), folded | TUCKED, start=start)
    assert "right_" not in free.may_reach(view)[0]
    areas = [each.planner.reachable_area(np.zeros(3)).sum() for each in (free, reach)]
    assert areas[0] > 2 * areas[1]


def test_a_joint_of_the_other_arm_that_turns_without_end_counts_and_a_wheel_does_not() -> None:
    """As the forearm and the wrist of PR2, whose gripper else seems to be somewhere else."""
    urdf, elbow = two_armed_urdf(), RIGHT[1]
    begin = urdf.index(f'"{elbow}" type="revolute"')
    robot = RobotModel.from_urdf(
        urdf[:begin] + urdf[begin:].replace("revolute", "continuous", 1), CAMERA
    )
    wheels = [joint.name for joint in robot.joints if joint.name.endswith("_wheel_joint")]
    joints = at_rest(robot) | TUCKED
    whole = WholeBody.of(robot, ReachingConfig(), joints)
    assert len(wheels) == 4
    assert WholeBody.of(robot, ReachingConfig(), joints | dict.fromkeys(wheels, 1.0)) is whole
    placed = whole.body.spheres(whole.driving, np.eye(4))
    lower = np.repeat(
        np.array(whole.body.links) == "right_lower", np.diff(whole.body.arrays.starts)
    )
    truth = robot.forward_kinematics(joints, "right_lower") @ (0.2, 0.0, 0.0, 1.0)
    np.testing.assert_allclose(placed[lower, :3].mean(axis=0), truth[:3], atol=0.02)
