"""Room for a robot that does not know exactly where it is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import make_transform
from infomap_ros.motion.base.base_planner import BasePlanner
from infomap_ros.motion.base.vehicle import Vehicle, VehicleConfig
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.whole_body import base_sigma, widenings_for

from .bodies import rover
from .grounds import FOLDED, ground, rover_model, stance_of
from .scenes import map_where
from .test_reaching import BASE, everything, looking


def gate_of(half: float):
    """Ground at z = 0 and a wall at x = 1.25, open for |y| < half."""

    def occupied(x, y, z):
        return (z < 0.0) | ((abs(x - 1.25) < 0.06) & (abs(y) > half))

    return occupied


def body_points(vehicle: Vehicle, count: int) -> np.ndarray:
    """Random points within the solids of a vehicle, wheels left out, base frame."""
    rng, points = np.random.default_rng(3), []
    for placed in vehicle.robot.solids_in(vehicle.robot.base_frame, vehicle.joint_positions):
        if placed.name in vehicle.undercarriage.names:
            continue
        radius = placed.solid.bounding_radius
        local = rng.uniform(-radius, radius, (count, 3))
        local = local[placed.solid.signed_distance(local) <= 0.0]
        points.append(local @ placed.transform[:3, :3].T + placed.transform[:3, 3])
    return np.concatenate(points)


def test_sigma_of_the_base_is_that_of_displaced_rims() -> None:
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(6, 6)) * np.array([[0.01] * 3 + [0.02] * 3]).T
    covariance = factor @ factor.T
    turn = Rotation.from_rotvec((0.1, -0.2, 2.0)).as_matrix()
    base, camera = make_transform(turn, (1.0, 2.0, 0.1)), make_transform(turn, (1.3, 2.2, 0.7))
    errors = rng.multivariate_normal(np.zeros(6), covariance, 20000)
    largest = 0.0
    for angle in np.linspace(0.0, 2.0 * np.pi, 64):
        point = base[:3, 3] + base[:3, :3] @ (0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.0)
        moved = errors[:, :3] + np.cross(errors[:, 3:], point - camera[:3, 3])
        largest = max(largest, np.linalg.eigvalsh(np.cov(moved[:, :2].T))[-1])
    assert base_sigma(camera, covariance, base, 0.5) == pytest.approx(np.sqrt(largest), rel=0.04)


def test_margin_grows_with_the_sigma_up_to_its_limit() -> None:
    config = VehicleConfig(margin=0.02)
    assert widenings_for(config, 0.0) == [0.0]
    assert widenings_for(config, 0.005) == [0.0]
    np.testing.assert_allclose(widenings_for(config, 0.0225), [0.03, 0.02, 0.01, 0.0])
    np.testing.assert_allclose(widenings_for(config, 0.5)[0], 0.06)


def test_wider_body_holds_the_body_wherever_it_may_be() -> None:
    vehicle, by = Vehicle.from_robot(rover_model(), joint_positions=FOLDED), 0.04
    wide = Vehicle.from_robot(rover_model(), joint_positions=FOLDED, wider=by)
    spacing, columns = vehicle.config.column_spacing, wide.arrays.columns
    squares: dict[tuple[float, ...], list[np.ndarray]] = {}
    for row in np.round(columns, 6):
        squares.setdefault(tuple(row[:2]), []).append(row[2:])
    points = body_points(vehicle, 2000)
    angles = np.random.default_rng(4).uniform(0.0, 2.0 * np.pi, len(points))
    points[:, :2] += by * np.column_stack([np.cos(angles), np.sin(angles)])
    middles = np.round((np.floor(points[:, :2] / spacing) + 0.5) * spacing, 6)
    for middle, height in zip(middles, points[:, 2], strict=True):
        assert any(low <= height <= high for low, high in squares[tuple(middle)])
    assert wide.arrays.columns[:, 2].min() >= vehicle.arrays.columns[:, 2].min() - 1e-9


@pytest.fixture(scope="module")
def joints() -> dict[str, float]:
    return {joint.name: 0.0 for joint in rover().joints}


def test_doubtful_pose_is_not_taken_through_a_gap_that_a_sure_one_passes(joints) -> None:
    robot, view = rover(), looking((2.2, 0.3, 0.6), 2.0, -0.3)
    narrow = map_where(gate_of(0.25), everything)
    assert WholeBodyReach(robot, narrow, BASE, joints).reach(view).reason == ""
    unsure = WholeBodyReach(robot, narrow, BASE, joints, sigma=0.04)
    assert unsure.is_wider
    assert unsure.reach(view).reason != ""
    wide = map_where(gate_of(0.35), everything)
    assert WholeBodyReach(robot, wide, BASE, joints, sigma=0.04).reach(view).reason == ""


def test_arm_leans_less_far_towards_a_slab_where_the_pose_is_in_doubt(joints) -> None:
    robot = rover()
    lift = robot.arm.joint_names[1]

    def slab(x, y, z):
        return (z < 0.0) | ((x > 0.5) & (x < 0.6) & (z > 0.3))

    around = map_where(slab, everything)
    sure, doubtful = (
        WholeBodyReach(robot, around, BASE, joints, sigma=sigma) for sigma in (0.0, 0.04)
    )
    here, leanings = np.zeros(3), np.arange(0.0, 1.2, 0.03)
    farthest = [
        max(by for by in leanings if reach.route_to(here, {lift: by}).reason == "")
        for reach in (sure, doubtful)
    ]
    assert 0.0 < farthest[1] < farthest[0] < leanings[-1]


def test_body_is_no_wider_than_where_it_stands_allows(joints) -> None:
    robot = rover()
    for gap in np.arange(0.1, 0.6, 0.05):

        def beside(x, y, z, gap=gap):
            return (z < 0.0) | ((y > gap) & (abs(x) < 1.0))

        closed = map_where(beside, everything)
        reach = WholeBodyReach(robot, closed, BASE, joints, sigma=0.1)
        if stance_of(reach.planner.vehicle, reach.terrain, 0.0, 0.0, 0.0).ok:
            break
    assert gap < 0.5 and reach.planner.vehicle.wider < 0.06


def test_robot_nearer_than_its_margin_leaves_without_turning_into_what_is_there() -> None:
    """It stands with its side at a bank that ends a little behind it, and may not turn there."""
    config = VehicleConfig(margin=0.06)
    vehicle = Vehicle.from_robot(rover_model(), config, FOLDED)
    bare, start = vehicle.without_margin, np.zeros(3)
    edge = next(
        edge for edge in np.arange(0.2, 0.6, 0.01) if stance_of(bare, bank(edge), 0.0, 0.0, 0.0).ok
    )
    terrain = bank(edge)
    assert not stance_of(vehicle, terrain, 0.0, 0.0, 0.0).ok
    assert not stance_of(bare, terrain, 0.0, 0.0, 0.8).ok
    planner = BasePlanner(terrain, vehicle)
    path = planner.plan(start, (0.0, -1.2, np.nan), samples=0)
    assert path.complete, path.reason
    assert bare.stances(terrain, path.poses).ok.all()


def bank(edge: float):
    """Flat ground, and a bank of 40 cm, 80 cm long, where y is larger than an edge [m]."""
    return ground(lambda x, y: np.where((y > edge) & (np.abs(x) < 0.4), 0.4, 0.0))
