"""Two simulated rovers find out how their maps lie to each other by a tag on one of them."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import invert_transform, make_transform, perturb_transform
from infomap_ros.localization.fiducials.range_view import StereoView
from infomap_ros.localization.target.team_alignment import (
    Alignment,
    RobotTagFinder,
    TeamAlignment,
    TeamTagsConfig,
    align_by_sighting,
    tag_pose,
)
from infomap_ros.simulation.body.robot import find_description, read_description
from infomap_ros.simulation.body.robot_body import add_tag_plates
from infomap_ros.simulation.cameras.stereo_camera import DRAWN_FAST, StereoCameraConfig
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.team_world import rover_tags, team_starts, with_plates
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import make_world, without_target
from infomap_ros.stereo import StereoConfig, StereoRangeSensor, StereoRectifier

BACK = tag_pose((-0.24, 0.0, 0.16), (-1.0, 0.0, 0.0))
TAGS = TeamTagsConfig(robots=(2,), ids=(5,), side=0.16, poses=tuple(map(float, BACK)))
ELSEWHERE = perturb_transform(np.eye(4), [2.0, -1.0, 0.1, 0.0, 0.0, 0.8])
EXACT = 1e-8 * np.eye(6)


def test_maps_are_aligned_by_the_tag_on_a_teammate(world: World, description: str) -> None:
    (carried,) = TAGS.carried()
    camera_config = StereoCameraConfig(width=320, height=240, supersampling=1)
    config = SimulatorConfig(seed=1, camera=camera_config)
    one = Simulator(world, description, config, {"two": description}, {"two": carried.tags.board})
    rectifier = StereoRectifier(*one.calibrations)
    sensor = StereoRangeSensor(rectifier.rig, StereoConfig())
    finder, told = RobotTagFinder([carried]), TeamAlignment(sightings=3)
    camera = one.true_camera_pose()
    ahead = camera[:2, 2] / np.linalg.norm(camera[:2, 2])
    found, distances = None, []
    for step in range(3):
        x, y = camera[:2, 3] + (1.2 + 0.1 * step) * ahead
        yaw = np.arctan2(ahead[1], ahead[0]) + 0.3 * (step - 1)
        turn = [[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
        base = make_transform(turn, (x, y, one.true_pose()[2, 3]))
        one.place_teammate("two", base, {})
        one.step(0.1)
        pair = one.capture()
        view = StereoView(pair.stamp, *rectifier.rectify(pair.left, pair.right), sensor)
        sightings, refused = finder.find(view, np.eye(4))
        assert not refused
        (sighting,) = sightings
        own = Alignment(one.true_camera_pose(), EXACT)
        seen = Alignment(sighting.T_base_other, sighting.covariance)
        theirs = Alignment(invert_transform(ELSEWHERE) @ base, EXACT)
        distances.append(np.linalg.norm((own.T_a_b @ seen.T_a_b)[:3, 3] - base[:3, 3]))
        found = told.add(align_by_sighting(own, seen, theirs))
    one.close()
    assert max(distances) < 0.02
    assert found is not None
    error = found.T_a_b @ invert_transform(ELSEWHERE)
    assert np.linalg.norm((error @ [*camera[:3, 3], 1.0])[:3] - camera[:3, 3]) < 0.03


def test_rovers_side_by_side_find_the_tags_on_each_other() -> None:
    world = make_world("mars", 1, size=5.0, **without_target("mars"))
    assert world.T_world_target is None
    description, tags = with_plates(read_description(find_description("config/rover.urdf"))), []
    starts, simulators = team_starts(world, 2, 1.3), []
    for number, start in enumerate(starts, start=1):
        (mate,) = rover_tags(2).carried(but=number)
        tags.append(mate)
        camera = StereoCameraConfig(width=320, height=240, **DRAWN_FAST)
        config = SimulatorConfig(seed=number, camera=camera, start=start.place)
        boards = {"mate": mate.tags.board}
        simulators.append(Simulator(world, description, config, {"mate": description}, boards))
    right, left = simulators
    right.place_teammate("mate", left.true_pose(), left.true_joints())
    turret, joints = right.arm_joints[0], right.true_joints()
    right.follow_arm_trajectory([turret], [[joints[turret]], [1.65]], [0.0, 1.5])
    right.step(3.0)
    rectifier, pair = StereoRectifier(*right.calibrations), right.capture()
    sensor = StereoRangeSensor(rectifier.rig, StereoConfig())
    view = StereoView(pair.stamp, *rectifier.rectify(pair.left, pair.right), sensor)
    (seen,), refused = RobotTagFinder([tags[0]]).find(view, np.eye(4))
    truth = invert_transform(right.true_camera_pose()) @ left.true_pose()
    for simulator in simulators:
        simulator.close()
    assert not refused and right.contacts == 0
    error = seen.T_base_other[:3, 3] - truth[:3, 3]
    assert np.linalg.norm(error) < 0.02
    assert error @ np.linalg.solve(seen.covariance[:3, :3], error) < 16.3


def test_tags_need_the_link_that_carries_them(world: World) -> None:
    (carried,) = TAGS.carried()
    with pytest.raises(RobotModelError, match="two/base"):
        add_tag_plates(world.spec.copy(), "two/base", carried.tags.board)
