"""Reaching views in maps with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, RobotModelError
from infomap_ros.geometry import make_transform, points_inside
from infomap_ros.motion.base.standing_ground import ClearStart
from infomap_ros.motion.reaching import ReachingConfig, WholeBodyReach
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.route import ReachResult

from .bodies import rover
from .scenes import map_where

BASE = make_transform(np.eye(3), (0.0, 0.0, 0.0762))


def everything(x, y, z):
    return np.ones(np.broadcast(x, y, z).shape, bool)


def ground(x, y, z):
    return z < 0.0


def wall_with_a_gate(x, y, z):
    """A wall at x = 1.25, open for |y| < 0.7."""
    return ground(x, y, z) | ((abs(x - 1.25) < 0.06) & (abs(y) > 0.7))


def closed_wall(x, y, z):
    return ground(x, y, z) | (abs(x - 1.25) < 0.06)


def looking(position, azimuth: float, steepness: float = 0.0) -> np.ndarray:
    """Optical frame at a position, its x axis level."""
    forward = np.array(
        [
            np.cos(azimuth) * np.cos(steepness),
            np.sin(azimuth) * np.cos(steepness),
            np.sin(steepness),
        ]
    )
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    return make_transform(np.column_stack([right, np.cross(forward, right), forward]), position)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return rover()


@pytest.fixture(scope="module")
def joints(robot: RobotModel) -> dict[str, float]:
    return {joint.name: 0.0 for joint in robot.joints}


@pytest.fixture(scope="module")
def gate(robot: RobotModel, joints: dict[str, float]) -> WholeBodyReach:
    return WholeBodyReach(robot, map_where(wall_with_a_gate, everything), BASE, joints)


def assert_reaches(reach: WholeBodyReach, result: ReachResult, view: np.ndarray) -> None:
    """The route is whole, and its last camera pose is the view within the tolerances."""
    assert result.reason == "" and not result.partial and result.route is not None
    route, chain = result.route, reach._whole.chain
    end = route.base_poses[-1] if route.moves_base else BASE
    camera = end @ chain.camera_pose(route.arm_after.positions[-1])
    np.testing.assert_allclose(result.T_map_camera, camera, atol=1e-12)
    assert np.linalg.norm(camera[:3, 3] - view[:3, 3]) <= reach.config.position_tolerance
    angle = np.arccos(np.clip(camera[:3, 2] @ view[:3, 2], -1.0, 1.0))
    assert angle <= reach.config.direction_tolerance


def test_base_stays_where_the_arm_alone_reaches(gate: WholeBodyReach) -> None:
    view = BASE @ gate._whole.chain.camera_pose([0.6, 0.5, 0.4, -0.3])
    result = gate.reach(view)
    assert_reaches(gate, result, view)
    assert result.route is not None and not result.route.moves_base
    assert result.travel == 0.0 and result.joint_travel > 0.1
    np.testing.assert_array_equal(result.route.arm_after.positions[0], np.zeros(4))


VIEWS = [
    looking((2.2, 0.3, 0.6), 2.0, -0.3),
    looking((-2.0, 1.0, 0.7), -1.0),
    looking((2.3, -1.4, 0.5), 0.5, -0.2),
    looking((-1.5, -1.8, 0.4), 3.0, -0.4),
]


@pytest.mark.parametrize("view", VIEWS)
def test_base_drives_where_the_arm_alone_does_not_reach(
    gate: WholeBodyReach, view: np.ndarray
) -> None:
    result = gate.reach(view)
    assert_reaches(gate, result, view)
    route, chain = result.route, gate._whole.chain
    assert route is not None and route.moves_base
    np.testing.assert_array_equal(route.arm_before.positions[0], np.zeros(4))
    np.testing.assert_allclose(route.arm_before.positions[-1], gate._whole.driving)
    np.testing.assert_allclose(route.arm_after.positions[0], gate._whole.driving)
    np.testing.assert_allclose(route.base_path[0], 0.0, atol=1e-9)
    assert np.hypot(*np.diff(route.base_path[:, :2], axis=0).T).max() < 0.2
    assert result.travel >= np.linalg.norm(view[:2, 3]) - 1.0
    crossing = np.abs(route.base_path[:, 0] - 1.25) < 0.1
    assert (np.abs(route.base_path[crossing, 1]) < 0.7).all()
    for q in (*route.arm_before.positions, *route.arm_after.positions):
        assert ((q >= chain.lower) & (q <= chain.upper)).all()


def test_views_behind_a_closed_wall_are_approached(
    robot: RobotModel, joints: dict[str, float]
) -> None:
    reach = WholeBodyReach(robot, map_where(closed_wall, everything), BASE, joints)
    result = reach.reach(looking((2.6, 0.5, 0.5), 0.0))
    assert result.partial and result.route is not None and result.route.partial
    assert "; the arm alone: out of reach" in result.reason
    assert result.route.base_path[-1, 0] > 0.3
    assert result.route.base_path[:, 0].max() < 1.2


def test_views_that_no_arm_holds_are_refused_before_any_route_is_sought(
    gate: WholeBodyReach,
) -> None:
    views = np.stack([*VIEWS, looking((0.5, 0.0, 1.9), 0.0), looking((9.0, 0.0, 0.5), 0.0)])
    reasons = gate.may_reach(views)
    assert reasons[:4] == [""] * 4
    assert all("no place to stand" in reason for reason in reasons[4:])


def test_quick_test_refuses_nothing_that_is_reached(gate: WholeBodyReach) -> None:
    rng = np.random.default_rng(7)
    views = [
        looking(
            rng.uniform((-2.2, -2.2, 0.25), (2.2, 2.2, 0.9)), *rng.uniform((-3, -0.8), (3, 0.4))
        )
        for _ in range(25)
    ]
    refused = [bool(reason) for reason in gate.may_reach(np.stack(views))]
    reached = [gate.reach(view).reason == "" for view in views]
    assert sum(reached) >= 8
    assert not any(a and b for a, b in zip(refused, reached, strict=True))


def test_view_in_an_obstacle_is_refused_by_name(gate: WholeBodyReach) -> None:
    result = gate.reach(looking((1.25, 1.5, 0.5), 0.0))
    assert result.reason and "map at (1." in result.reason


def test_unknown_ground_is_not_driven_on(robot: RobotModel, joints: dict[str, float]) -> None:
    """Known is only what lies within 1.2 m of the start."""
    near = map_where(ground, lambda x, y, z: np.hypot(x, y) < 1.2)
    reach = WholeBodyReach(robot, near, BASE, joints)
    result = reach.reach(looking((2.5, 0.0, 0.5), 0.0))
    assert result.reason
    if result.route is not None:
        assert np.hypot(*result.route.base_path[:, :2].T).max() < 1.2


def test_robot_in_unknown_space_may_leave_its_own_place_only(
    robot: RobotModel, joints: dict[str, float]
) -> None:
    """Nothing was ever seen: the arm may move within a hand's breadth, and not lean far out."""
    nothing = map_where(ground, lambda x, y, z: z < 0.0)
    reach = WholeBodyReach(robot, nothing, BASE, joints)
    chain = reach._whole.chain
    far = reach.reach(BASE @ chain.camera_pose([0.0, 1.4, 0.3, 0.0]))
    assert "with the map at" in far.reason
    near = BASE @ chain.camera_pose([0.0, 0.02, 0.0, -0.02])
    assert reach.reach(near).reason == ""


def test_route_home_ends_in_place_and_posture(gate: WholeBodyReach) -> None:
    home = {"arm_shoulder_joint": 0.3, "arm_elbow_joint": -0.4}
    result = gate.route_to((-1.0, 0.8, 1.2), home)
    assert result.reason == "" and result.route is not None
    end = result.route.base_path[-1]
    np.testing.assert_allclose(end[:2], (-1.0, 0.8), atol=0.05)
    assert abs(np.angle(np.exp(1j * (end[2] - 1.2)))) < 0.1
    np.testing.assert_allclose(result.route.arm_after.positions[-1], (0.0, 0.3, -0.4, 0.0))


def test_route_home_of_a_robot_at_home_moves_the_arm_only(gate: WholeBodyReach) -> None:
    result = gate.route_to((0.0, 0.0, 0.0), {"arm_pan_joint": 0.5})
    assert result.reason == "" and result.route is not None
    assert not result.route.moves_base and result.joint_travel == pytest.approx(0.5)


def test_routes_keep_the_limits_where_an_encoder_is_beyond_them(
    robot: RobotModel, joints: dict[str, float]
) -> None:
    beyond = joints | {"arm_elbow_joint": -2.701, "arm_shoulder_joint": 0.6}
    reach = WholeBodyReach(robot, map_where(ground, everything), BASE, beyond)
    result = reach.reach(VIEWS[1])
    assert result.reason == "" and result.route is not None
    for path in (result.route.arm_before, result.route.arm_after):
        assert path.moves
        assert (path.positions >= robot.arm.lower).all()
        assert (path.positions <= robot.arm.upper).all()


def test_arm_joint_without_a_position_is_named(robot: RobotModel) -> None:
    with pytest.raises(RobotModelError, match="arm_elbow_joint"):
        WholeBodyReach(
            robot,
            map_where(ground, everything),
            BASE,
            {"arm_pan_joint": 0.0, "arm_shoulder_joint": 0.0, "arm_wrist_joint": 0.0},
        )


def test_driving_posture_must_fit_the_arm(robot: RobotModel, joints: dict[str, float]) -> None:
    config = ReachingConfig(driving_posture=(0.0, 9.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="driving_posture"):
        WholeBodyReach(robot, map_where(ground, everything), BASE, joints, config)


def test_an_instance_before_does_not_change_what_is_said_of_the_ground(
    robot: RobotModel, joints: dict[str, float], gate: WholeBodyReach
) -> None:
    """A gate that closes: what is said with the instance before is what is said without it."""
    area = gate.planner.reachable_area(gate._xyyaw)
    closed = map_where(closed_wall, everything)
    alone = WholeBodyReach(robot, closed, BASE, joints)
    after = WholeBodyReach(robot, closed, BASE, joints, previous=gate)
    expected = alone.planner.reachable_area(alone._xyyaw)
    np.testing.assert_array_equal(after.planner.reachable_area(after._xyyaw), expected)
    assert expected.sum() < area.sum()


@pytest.mark.parametrize("x", [1.0, -0.3])
def test_robot_that_has_only_looked_ahead_can_leave_its_place(
    robot: RobotModel, joints: dict[str, float], x: float
) -> None:
    """Nothing is known where its rear wheels stand, nor beyond."""
    ahead = map_where(ground, lambda x, y, z: x > 0.3)
    reach = WholeBodyReach(robot, ahead, BASE, joints, start=ClearStart(BASE, 0.9))
    result = reach.route_to((x, 0.0, 0.0), {})
    assert result.reason == "" and result.travel == pytest.approx(abs(x), abs=0.01)


def test_space_that_blocks_the_base_for_it_was_never_seen_is_named(
    robot: RobotModel, joints: dict[str, float]
) -> None:
    """Beyond 1 m the camera has seen the ground and little above it: no place for the body."""
    low = map_where(ground, lambda x, y, z: (np.hypot(x, y) < 1.0) | (z < 0.2))
    reach = WholeBodyReach(robot, low, BASE, joints)
    assert reach.route_to((1.5, 0.0, 0.0), {}).reason != ""
    boxes = reach.unseen_ahead
    assert boxes
    for place in ((1.2, 0.0, 0.25), (-1.0, 0.7, 0.3), (0.0, -1.3, 0.3)):
        assert points_inside([place], boxes).all()
    assert not points_inside([(0.0, 0.0, 0.3), (1.2, 0.0, 0.0), (1.2, 0.0, 2.0)], boxes).any()
    seen = WholeBodyReach(robot, map_where(ground, everything), BASE, joints)
    assert seen.unseen_ahead == []
    assert seen.route_to((1.5, 0.0, 0.0), {}).reason == ""


def test_another_compact_posture_drives_where_the_usual_one_is_blocked(
    robot: RobotModel, joints: dict[str, float], gate: WholeBodyReach
) -> None:
    """A thing where the folded arm would be, and the arm is not."""
    body, usual = gate._whole.body, gate._whole.driving
    moves = np.repeat(body.arrays.bodies > 0, np.diff(body.arrays.starts))
    folded, now = body.spheres(usual, BASE), body.spheres(np.zeros(4), BASE)
    gaps = np.linalg.norm(folded[:, None, :3] - now[None, :, :3], axis=-1) - now[:, 3]
    thing = folded[int(np.argmax(np.where(moves, gaps.min(axis=1), 0.0))), :3]

    def occupied(x, y, z):
        near = np.maximum.reduce([abs(x - thing[0]), abs(y - thing[1]), abs(z - thing[2])]) < 0.05
        return wall_with_a_gate(x, y, z) | near

    reach = WholeBodyReach(robot, map_where(occupied, everything), BASE, joints)
    assert np.abs(reach._whole.driving - usual).max() > 0.1
    result = reach.reach(VIEWS[0])
    assert_reaches(reach, result, VIEWS[0])
    assert result.route is not None and result.route.moves_base
    q = result.route.arm_before.positions[-1]
    np.testing.assert_allclose(q, reach._whole.driving)
    assert not reach.near.checker_at(BASE).contact(q, BASE)
    outline = np.abs(body.spheres(q, np.eye(4))[moves][:, :2]).max()
    assert reach.planner.vehicle.arrays.reach >= outline  # it drives with the outline of that
