"""How the rover stands, against geometry worked out otherwise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError, RobotModelError
from infomap_ros.motion.base.stance import tip_margin
from infomap_ros.motion.base.vehicle import Vehicle, VehicleConfig
from infomap_ros.motion.robot.robot_model import RobotModel

from .grounds import FOLDED, ground, plane, rough, rover, rover_model, stance_of
from .known_robots import KNOWN_ROBOTS

RADIUS = 0.0762
HALF_TRACK = 0.1591


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return rover()


def test_on_level_ground_the_axles_are_a_radius_above_it(vehicle):
    stance = stance_of(vehicle, ground(plane(0.0, 0.0, 0.3)), 0.4, -0.2, 1.0)
    assert stance.ok and stance.reason == ""
    np.testing.assert_allclose(stance.T_map_base[:3, 3], (0.4, -0.2, 0.3 + RADIUS), atol=1e-6)
    turn = Rotation.from_euler("z", 1.0).as_matrix()
    np.testing.assert_allclose(stance.T_map_base[:3, :3], turn, atol=1e-6)


def test_on_a_slope_it_stands_parallel_to_it_with_its_heading(vehicle, rng):
    for slope_x, slope_y, yaw in rng.uniform((-0.25, -0.25, -3), (0.25, 0.25, 3), (20, 3)):
        stance = stance_of(vehicle, ground(plane(slope_x, slope_y)), 0.1, 0.2, yaw)
        pose, normal = stance.T_map_base, np.array([-slope_x, -slope_y, 1.0])
        normal /= np.linalg.norm(normal)
        np.testing.assert_allclose(pose[:3, 2], normal, atol=1e-5)
        assert math.atan2(pose[1, 0], pose[0, 0]) == pytest.approx(yaw, abs=1e-9)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        assert stance.slope == pytest.approx(np.arccos(normal[2]), abs=1e-5)
        # The treads are sampled: the wheel's distance to the plane is met within 1 mm.
        gap = pose[:3, 3] @ normal - RADIUS
        assert -1e-3 < gap < 1e-3


def test_wheels_settle_as_equal_springs(vehicle, rng):
    """The plane of the wheels is the least-squares one of the heights at which they touch."""
    terrain = ground(rough(rng, 0.05))
    for x, y, yaw in rng.uniform((-1, -1, -3), (1, 1, 3), (10, 3)):
        pose = stance_of(vehicle, terrain, x, y, yaw).T_map_base

        def gaps(tilt, pose=pose, yaw=yaw, terrain=terrain):
            height, pitch, roll = tilt
            turn = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_matrix()
            points = vehicle.arrays.contacts @ turn.T + (pose[0, 3], pose[1, 3], height)
            return (interpolated(terrain, points[..., :2]) - points[..., 2]).max(axis=1)

        _, pitch, roll = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")
        start = np.array([pose[2, 3], pitch, roll])
        best = least_squares(gaps, start).x
        assert np.linalg.norm(gaps(start)) < np.linalg.norm(gaps(best)) + 0.003
        assert np.abs(start - best).max() < 0.02


def interpolated(terrain, points):
    """Bilinear height between the cells' middles."""
    from scipy.interpolate import RegularGridInterpolator

    axes = [
        terrain.origin[k] + (np.arange(terrain.heights.shape[k]) + 0.5) * terrain.resolution
        for k in range(2)
    ]
    return RegularGridInterpolator(axes, terrain.heights.astype(float))(points)


def pose_on(slope_x: float, slope_y: float, yaw: float) -> np.ndarray:
    return stance_of(rover(), ground(plane(slope_x, slope_y)), 0.0, 0.0, yaw).T_map_base


def test_tip_margin_of_a_symmetric_body_is_that_of_the_closed_form():
    """Sideways on a slope of angle a: atan(half track / height) less or plus a, the smaller."""
    side, height = HALF_TRACK, 0.25
    support = np.array([[side, side, 0], [-side, side, 0], [-side, -side, 0], [side, -side, 0]])
    for slope in (0.0, 0.2, -0.3):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("x", slope).as_matrix()
        expected = math.atan2(side, height) - abs(slope)
        margin = tip_margin(pose, support, np.array([0.0, 0.0, height]))
        assert margin == pytest.approx(expected, abs=1e-9)


def test_tip_margin_is_the_turn_after_which_the_mass_is_above_an_edge(vehicle, rng):
    """Turned by the margin about the edge that gives way, the center of mass is at its highest."""
    support, center = vehicle.arrays.support, vehicle.arrays.center_of_mass
    for angles in rng.uniform(-0.4, 0.4, (20, 2)):
        turn = Rotation.from_euler("xy", angles).as_matrix()
        pose = np.eye(4)
        pose[:3, :3] = turn
        corners, mass = support @ turn.T, turn @ center
        turns = []
        for here, following in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            axis = (following - here) / np.linalg.norm(following - here)
            tilts = np.linspace(-1.5, 1.5, 60001)
            arm = mass - here
            arm -= axis * (axis @ arm)
            lifted = np.cos(tilts) * arm[2] + np.sin(tilts) * np.cross(axis, arm)[2]
            turns.append(abs(tilts[lifted.argmax()]))
        assert tip_margin(pose, support, center) == pytest.approx(min(turns), abs=1e-4)


def test_center_of_mass_moves_with_the_arm(vehicle):
    """Sum over the links of the URDF, each at its own place."""
    import xml.etree.ElementTree as ElementTree

    from .grounds import ROVER

    model = rover_model()
    joints = {**vehicle.joint_positions, "arm_pan_joint": 0.7, "arm_shoulder_joint": 1.1}
    total, moment = 0.0, np.zeros(3)
    for link in ElementTree.parse(ROVER).getroot().findall("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            mass = float(inertial.find("mass").get("value"))
            center = np.array([float(v) for v in inertial.find("origin").get("xyz").split()])
            pose = model.forward_kinematics(joints, link.get("name"))
            total, moment = total + mass, moment + mass * (pose[:3, :3] @ center + pose[:3, 3])
    moved = vehicle.with_joints(joints)
    np.testing.assert_allclose(moved.arrays.center_of_mass, moment / total, atol=1e-9)


def test_stretching_the_arm_lowers_the_tip_margin(vehicle):
    terrain = ground(plane(0.0, 0.0))
    folded = stance_of(vehicle, terrain, 0.0, 0.0, 0.0)
    stretched = stance_of(vehicle, terrain, 0.0, 0.0, 0.0, q=(math.pi / 2, math.pi / 2, 0.0, 0.0))
    same = vehicle.with_joints(
        {"arm_pan_joint": math.pi / 2, "arm_shoulder_joint": math.pi / 2, "arm_elbow_joint": 0.0}
    )
    assert stretched.tip_margin < folded.tip_margin - 0.03
    assert stretched.tip_margin == pytest.approx(
        stance_of(same, terrain, 0.0, 0.0, 0.0).tip_margin, abs=1e-9
    )


def bump(x0, y0, size, height):
    return lambda x, y: np.where(np.hypot(x - x0, y - y0) < size, height, 0.0)


def test_stone_between_the_wheels_is_straddled_up_to_the_clearance(vehicle):
    """The deck's underside is 8.6 cm above ground, the margin 2 cm, the columns' grid 1 cm."""
    for height, good in ((0.05, True), (0.08, False), (0.3, False)):
        stance = stance_of(vehicle, ground(bump(0.0, 0.0, 0.06, height)), 0.0, 0.0, 0.0)
        assert stance.ok is good, stance.reason
    assert "base_link touches the ground" in stance.reason
    assert stance.clearance < 0.0


def test_low_stone_that_may_be_noise_of_the_ground_does_not_stop_the_body(vehicle):
    """Level ground seen from afar: a robot with 2 cm of clearance else could not move."""
    for sigma, height, good in (
        (0.02, 0.08, True),
        (0.02, 0.10, False),
        (0.02, 0.12, False),
        (0.01, 0.09, False),
    ):
        terrain = ground(bump(0.0, 0.0, 0.06, height), sigma=sigma)
        stance = stance_of(vehicle, terrain, 0.0, 0.0, 0.0)
        assert stance.ok is good, (sigma, height, stance.reason)


@pytest.mark.parametrize(
    ("height", "options", "yaw", "reason"),
    [
        (plane(0.6, 0.0), {}, 0.3, "slope of 31 deg, limit 25 deg"),
        (bump(0.16, 0.16, 0.06, 0.09), {}, 0.0, "step of 0.090 m under a wheel"),
        (lambda x, y: 0.04 * np.sign(np.sin(50 * x) * np.sin(50 * y)), {"max_step": 1.0}, 0.0,
         "roughness"),
        (bump(0.16, 0.16, 0.2, 0.15), {"max_step": 1.0, "max_roughness": 1.0}, 0.0,
         "off the plane"),
        (plane(0.3, 0.0), {"min_tip_margin": 0.7}, 0.0, "tip-over margin"),
        (lambda x, y: np.where(np.hypot(x - 0.16, y - 0.16) < 0.04, np.nan, 0.0), {}, 0.0,
         "unknown ground under front_left_wheel"),
        (lambda x, y: np.where(np.hypot(x, y) < 0.06, np.nan, 0.0), {}, 0.0,
         "unknown ground under the body"),
    ],
)  # fmt: skip
def test_each_refusal_says_why(height, options, yaw, reason):
    stance = stance_of(rover(**options), ground(height), 0.0, 0.0, yaw)
    assert not stance.ok
    assert reason in stance.reason


def test_outside_is_refused(vehicle):
    assert "outside" in stance_of(vehicle, ground(plane(0, 0)), 5.0, 0.0, 0.0).reason


def test_it_drives_under_what_is_higher_than_it_is(vehicle):
    top = vehicle.arrays.columns[:, 3].max() + RADIUS
    for height, good in ((top + 0.01, True), (top - 0.01, False), (0.2, False)):
        terrain = ground(plane(0, 0), overhead=lambda x, y, height=height: height + 0.0 * x)
        stance = stance_of(vehicle, terrain, 0.0, 0.0, 0.5)
        assert stance.ok is good
    assert " touches an obstacle at (" in stance.reason


def test_space_must_have_been_seen_as_high_as_the_user_says():
    terrain = ground(plane(0, 0), seen=lambda x, y: 0.2 + 0.0 * x)
    assert " enters space that was never seen at (" in stance_of(rover(), terrain, 0, 0, 0).reason
    assert "never seen" in stance_of(rover(seen_height=0.21), terrain, 0, 0, 0).reason
    assert stance_of(rover(seen_height=0.19), terrain, 0, 0, 0).ok
    assert stance_of(rover(seen_height=0.0), terrain, 0, 0, 0).ok
    low = ground(plane(0, 0), seen=lambda x, y: 0.2 + 0.0 * x, overhead=lambda x, y: 0.2 + 0.0 * x)
    assert " touches an obstacle at (" in stance_of(rover(seen_height=0.19), low, 0, 0, 0).reason


def test_the_link_that_touches_and_the_place_are_named(vehicle):
    """A beam across, lower than the body is high: at the highest solid that Pinocchio finds."""
    beam = 0.2
    terrain = ground(plane(0, 0), overhead=lambda x, y: np.where(np.abs(x - 0.3) < 0.1, beam, 9.0))
    stance = stance_of(vehicle, terrain, 0.3, 0.0, 0.0)
    link, _, place = stance.reason.partition(" touches an obstacle at (")
    x, y, z = (float(value) for value in place.rstrip(")").split(", "))
    local = (np.linalg.inv(stance.T_map_base) @ (x, y, z, 1.0))[:3]
    away: dict[str, float] = {}
    for solid in vehicle.robot.solids_in("base_link", vehicle.joint_positions):
        place = (local - solid.transform[:3, 3]) @ solid.transform[:3, :3]
        distance = float(solid.solid.signed_distance(place[None])[0])
        away[solid.name] = min(distance, away.get(solid.name, np.inf))
    assert abs(x - 0.3) < 0.15
    assert z > beam
    assert away[link] == min(away.values()) < 0.08


def test_what_stands_beside_a_wheel_is_touched(vehicle):
    """A post of 0.3 m just outside the front left wheel; its tread touches no step."""
    lateral = HALF_TRACK + 0.032
    for away, good in ((0.02, False), (0.12, True)):
        post = bump(HALF_TRACK, lateral + away, 0.03, 0.3)
        config = {"max_step": 1.0, "max_roughness": 1.0}
        terrain = ground(post, cell=0.01)
        assert stance_of(rover(**config), terrain, 0.0, 0.0, 0.0).ok is good


def test_batch_and_single_stances_agree(vehicle, rng):
    terrain = ground(rough(rng, 0.08))
    places = rng.uniform((-2, -2, -4), (2, 2, 4), (60, 3))
    batch = vehicle.stances(terrain, places)
    assert 0.1 < batch.ok.mean() < 0.9
    for place, pose, good in zip(places, batch.T_map_base, batch.ok, strict=True):
        stance = stance_of(vehicle, terrain, *place)
        assert stance.ok == good == (stance.reason == "")
        np.testing.assert_array_equal(stance.T_map_base, pose)


def test_robot_on_a_footprint_rests_on_its_corners():
    config = VehicleConfig(
        footprint=(0.2, 0.1, -0.2, 0.1, -0.2, -0.1, 0.2, -0.1), ground_height=-0.05, max_step=0.05
    )
    robot = Vehicle.from_robot(rover_model(), config, FOLDED)
    pose = stance_of(robot, ground(plane(0.1, 0.0)), 0.0, 0.0, 0.0).T_map_base
    np.testing.assert_allclose(pose[:3, 2], np.array([-0.1, 0, 1]) / np.hypot(0.1, 1), atol=1e-6)
    below = pose[:3, :3] @ (0.0, 0.0, -0.05) + pose[:3, 3]
    assert below[2] == pytest.approx(0.1 * below[0], abs=1e-6)


SKIRT = """<robot name="skirt"><link name="base">
<inertial><origin xyz="0 0 0.15"/><mass value="10"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.2"/><geometry><box size="0.7 0.4 0.4"/></geometry></collision>
</link></robot>"""


def test_shapes_that_reach_down_to_the_ground_are_no_body_below_the_highest_step():
    """A box that encloses the wheels stands on level ground, and not beside a higher step."""
    config = VehicleConfig(footprint=(0.2, 0.1, -0.2, 0.1, -0.2, -0.1, 0.2, -0.1), max_step=0.04)
    robot = Vehicle.from_robot(RobotModel.from_urdf(SKIRT), config)

    def step(height):
        return lambda x, y: np.where(x > 0.3, height, 0.0)

    assert stance_of(robot, ground(plane(0.0, 0.0)), 0.0, 0.0, 0.0).ok
    assert stance_of(robot, ground(step(0.03)), 0.0, 0.0, 0.0).ok
    assert "touches" in stance_of(robot, ground(step(0.1)), 0.0, 0.0, 0.0).reason


@pytest.mark.parametrize(("name", "wheels"), [("stretch", 3), ("tiago", 6)])
def test_robots_of_others_stand_level_without_settings(name, wheels):
    robot = Vehicle.from_robot(KNOWN_ROBOTS[name]())
    assert len(robot.undercarriage.names) == wheels
    stance = stance_of(robot, ground(plane(0.0, 0.0)), 0.1, 0.2, 0.5)
    assert stance.ok, stance.reason
    assert stance.slope < 1e-3
    lowest = robot.arrays.support @ stance.T_map_base[:3, :3].T + stance.T_map_base[:3, 3]
    np.testing.assert_allclose(lowest[:, 2], 0.0, atol=1e-3)
    assert 0.2 < stance.tip_margin < 0.8


LINK = '<robot name="r"><link name="base">{}</link></robot>'
BOX = '<collision><geometry><box size="1 1 1"/></geometry></collision>'


@pytest.mark.parametrize(
    ("config", "xml", "match"),
    [
        ({}, LINK.format(BOX), "0 links with a collision shape that match"),
        ({"max_step": 0.1, "footprint": (0.0, 0.0, 1.0, 1.0)}, LINK.format(BOX), "3 or more"),
        (
            {"max_step": 0.1, "footprint": (0.0, 0.0, 1.0, 1.0, 2.0, 2.0)},
            LINK.format(BOX),
            "one line",
        ),
        (
            {"max_step": 0.1, "footprint": (0.0, 0.0, 1.0, 0.0, 0.0, 1.0)},
            LINK.format(BOX),
            "no inertials",
        ),
    ],
)
def test_robot_that_cannot_stand_is_refused(config, xml, match):
    with pytest.raises(RobotModelError, match=match):
        Vehicle.from_robot(RobotModel.from_urdf(xml), VehicleConfig(**config))


def test_nonsense_is_refused_by_name(vehicle):
    with pytest.raises(InvalidInputError, match="places"):
        vehicle.stances(ground(plane(0, 0)), [[0.0, 0.0]])
    with pytest.raises(InvalidInputError, match="places"):
        stance_of(vehicle, ground(plane(0, 0)), math.nan, 0.0, 0.0)
    with pytest.raises(ConfigError, match="max_slope"):
        VehicleConfig(max_slope=-1.0)
    with pytest.raises(ConfigError, match="max_step"):
        VehicleConfig(footprint=(0.0, 0.0, 1.0, 0.0, 0.0, 1.0))


def test_wheel_climbs_three_quarters_of_its_radius():
    for height, good in ((0.74 * RADIUS, True), (0.76 * RADIUS, False)):
        kerb = ground(lambda x, y, height=height: np.where(x > 0.16, height, 0.0))
        config = {"max_roughness": 1.0, "suspension_travel": 1.0}
        assert stance_of(rover(**config), kerb, 0.0, 0.0, 0.0).ok is good


def test_ground_that_seems_a_little_worse_while_driving_breaks_nothing_off() -> None:
    """Noise of the ground is no obstacle; a box is."""
    config = VehicleConfig(footprint=(0.2, 0.1, -0.2, 0.1, -0.2, -0.1, 0.2, -0.1), max_step=0.04)
    robot = Vehicle.from_robot(RobotModel.from_urdf(SKIRT), config)

    def reasons(height):
        edge = ground(lambda x, y: np.where(x > 0.15, height, 0.0))
        return [stance_of(one, edge, 0.0, 0.0, 0.0).reason for one in (robot, robot.while_driving)]

    assert "step" in reasons(0.05)[0] and reasons(0.05)[1] == ""
    assert all(reasons(0.1))
