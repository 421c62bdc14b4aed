"""A teammate that was mapped before it was heard is taken out of the map when it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from infomap_ros.exploration.team.teammate_places import TeamBodies
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import NOT_OBSERVED, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.correctable_map import CorrectableMap
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from test.exploration.test_team_bodies import (
    CAMERA,
    COVARIANCES,
    FLOOR,
    LOOKING,
    occupied_near,
    seen_at,
    told,
)

WHEN = 430  # [ms]; it stands where it is then
SHIFT = 0.05  # [m]


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_urdf(find_share("config/rover.urdf"), base_frame="base_link")


def mapped_as_scene(robot: RobotModel, memory: float) -> CorrectableMap:
    """A map into which a teammate was fused that nobody knew of."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05, max_range=5.0))
    voxel_map.track_changes(True)
    corrected = CorrectableMap(voxel_map, ScanStoreConfig(memory=memory))
    points = seen_at(robot, WHEN)[0]
    for stamp in range(4):
        corrected.integrate(stamp, points, LOOKING, COVARIANCES, camera=CAMERA)
    return corrected


def forget_arrivals(corrected: CorrectableMap, bodies: TeamBodies) -> list[int]:
    arrivals = bodies.take_arrivals()
    for body in arrivals:
        config = BodyFilterConfig(margin=body.margin)
        corrected.forget_body(body.solids, config, body.ground)
    return [body.robot for body in arrivals]


def ground_voxels(voxel_map: VoxelMap) -> int:
    """Surface points within 1 cm of the floor."""
    return int((np.abs(voxel_map.gaussians()[1][:, 2] - FLOOR) < 0.01).sum())


@pytest.mark.parametrize("memory", [0.0, 1.0], ids=["voxels", "scans"])
def test_who_stood_in_view_before_it_was_heard_is_taken_out(
    robot: RobotModel, memory: float
) -> None:
    corrected = mapped_as_scene(robot, memory)
    voxel_map, before = corrected.voxel_map, corrected.voxel_map.known_voxels
    image = occupied_near(voxel_map, robot, [WHEN])
    voxel_map.take_changes()
    floor = ground_voxels(voxel_map)
    bodies = TeamBodies()
    bodies.receive(told(robot, WHEN, 1))
    assert forget_arrivals(corrected, bodies) == [], "its solids are not known yet"
    bodies.describe(2, robot)

    assert forget_arrivals(corrected, bodies) == [2]

    assert image > 30 and occupied_near(voxel_map, robot, [WHEN]) == 0
    assert ground_voxels(voxel_map) == floor > 100, "the others lose no ground"
    gone = voxel_map.take_changes()
    assert (gone.log_odds == NOT_OBSERVED).all() and not gone.has_gaussian.any()
    assert len(gone.indices) == before - voxel_map.known_voxels < 0.1 * before
    assert forget_arrivals(corrected, bodies) == [], "once"


def test_it_does_not_come_back_with_scans_that_are_moved(robot: RobotModel) -> None:
    corrected = mapped_as_scene(robot, 1.0)
    bodies = TeamBodies()
    bodies.describe(2, robot)
    bodies.receive(told(robot, WHEN, 1))
    forget_arrivals(corrected, bodies)
    moved = LOOKING.copy()
    moved[0, 3] -= SHIFT

    corrected.receive_poses(3, [0, 1, 2, 3], np.array([LOOKING] * 4))
    corrected.receive_poses(4, [0, 1, 2, 3], np.array([moved] * 4))
    report = corrected.correct()

    assert report is not None and report.scans_moved == 4
    assert occupied_near(corrected.voxel_map, robot, [WHEN]) == 0
    assert corrected.voxel_map.surface_voxels > 100


def test_who_was_forgotten_and_is_back_is_taken_out_where_it_was_and_is(robot: RobotModel) -> None:
    """It was forgotten, mapped, and has folded its arm before it is heard again."""
    bodies = TeamBodies()
    bodies.describe(2, robot)
    bodies.receive(told(robot, WHEN, 1))
    bodies.take_arrivals()
    bodies.keep([])
    corrected = mapped_as_scene(robot, 0.0)
    agent = told(robot, WHEN, 2)
    bodies.receive(replace(agent, joints=dict.fromkeys(agent.joints, 0.0)))
    bodies.describe(2, robot)

    assert forget_arrivals(corrected, bodies) == [2, 2]

    assert occupied_near(corrected.voxel_map, robot, [WHEN]) == 0


def test_who_does_not_know_well_where_it_is_is_waited_for(robot: RobotModel) -> None:
    bodies = TeamBodies()
    bodies.describe(2, robot)
    agent = told(robot, WHEN, 1)
    bodies.receive(replace(agent, covariance=np.diag([0.3**2] * 6)))
    assert bodies.take_arrivals() == []
    bodies.receive(told(robot, WHEN + 200, 2))
    assert len(bodies.take_arrivals()) == 1
