"""TIAGo and Stretch plan routes to views, with parameters only: a gate in a wall, known ground."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest

from infomap_ros.geometry import make_transform
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion.base.vehicle import VehicleConfig
from infomap_ros.motion.collision.body import CollisionConfig
from infomap_ros.motion.reaching import ReachingConfig, WholeBodyReach
from infomap_ros.motion.robot.robot_model import RobotModel

from .known_robots import TELESCOPE, TIAGO_ARM, stretch, tiago
from .scenes import map_where

FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
BEYOND_THE_GATE = make_transform(FORWARD, (2.2, 0.3, 0.6))
BEHIND = make_transform(np.diag([1.0, -1.0, -1.0]) @ FORWARD, (-1.5, -0.8, 0.7))
FOLDED = dict(zip(TIAGO_ARM, (0.2, -1.3, -0.2, 1.94, -1.57, 1.37, 0.0), strict=True))


@pytest.fixture(scope="module")
def gate() -> VoxelMap:
    """A wall at x = 1.25 m, open for |y| < 0.7 m; free up to 2.1 m."""
    return map_where(
        lambda x, y, z: (z < 0.0) | ((abs(x - 1.25) < 0.06) & (abs(y) > 0.7)),
        lambda x, y, z: np.ones(np.broadcast(x, y, z).shape, bool),
        height=2.6,
    )


@cache
def known(name: str) -> RobotModel:
    """What reaching finds out about a robot is kept as long as it is the same object."""
    return tiago(arm_joints=TIAGO_ARM) if name == "tiago" else stretch(mimics=TELESCOPE)


def reach_of(
    robot: RobotModel, gate: VoxelMap, config: ReachingConfig, joints: Mapping[str, float]
) -> tuple[WholeBodyReach, dict[str, float]]:
    """Starts at the origin, the joints that are not given at rest."""
    everything = {joint.name: joint.rest for joint in robot.joints} | dict(joints)
    return WholeBodyReach(robot, gate, np.eye(4), everything, config), everything


def assert_reached(
    robot: RobotModel, reach: WholeBodyReach, joints: dict[str, float], view: np.ndarray
) -> None:
    """The camera, placed by Pinocchio at the end of the route, is at the view."""
    result = reach.reach(view)
    assert result.reason == ""
    assert result.route is not None and result.route.moves_base
    end = robot.arm.by_name(result.route.arm_after.positions[-1])
    T_base_camera = robot.forward_kinematics(joints | end, robot.camera_frame)
    camera = result.route.base_poses[-1] @ T_base_camera
    assert np.linalg.norm(camera[:3, 3] - view[:3, 3]) <= reach.config.position_tolerance
    assert camera[:3, 2] @ view[:3, 2] >= np.cos(reach.config.direction_tolerance)
    crossing = np.abs(result.route.base_path[:, 0] - 1.25) < 0.1
    assert (np.abs(result.route.base_path[crossing, 1]) < 0.7).all()


@pytest.mark.parametrize("view", [BEYOND_THE_GATE, BEHIND], ids=["beyond the gate", "behind"])
def test_tiago_reaches_views_with_its_lift_raised(gate, view):
    robot = known("tiago")
    config = ReachingConfig(
        vehicle=VehicleConfig(
            footprint=(0.2, 0.2, -0.2, 0.2, -0.2, -0.2, 0.2, -0.2), max_step=0.02
        ),
        collision=CollisionConfig(ground_links=("*wheel*", "*caster*", "base_link")),
    )
    reach, joints = reach_of(robot, gate, config, {**FOLDED, "torso_lift_joint": 0.15})
    assert_reached(robot, reach, joints, view)


@pytest.mark.parametrize("view", [BEYOND_THE_GATE, BEHIND], ids=["beyond the gate", "behind"])
def test_stretch_reaches_views_on_its_wheels_and_caster(gate, view):
    robot = known("stretch")
    config = ReachingConfig(
        vehicle=VehicleConfig(
            wheel_links="link_*_wheel,caster_link", max_step=0.02, min_tip_margin=0.15
        ),
        collision=CollisionConfig(ground_links=("link_*_wheel", "caster_link", "base_link")),
    )
    reach, joints = reach_of(robot, gate, config, {"joint_lift": 0.6, "joint_arm_l3": 0.05})
    assert_reached(robot, reach, joints, view)
