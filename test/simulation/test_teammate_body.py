"""Several robots in one world: each is simulated for itself and finds the others in its way."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError, RobotModelError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.simulation.body.robot_body import RobotBody
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.terrain import Terrain

CONFIG = SimulatorConfig(camera=StereoCameraConfig(width=64, height=48, supersampling=1))
LINKS = ("base_link", "arm_turret", "arm_forearm", "stereo_link", "left_camera_optical_frame")
CAMERA = PinholeCamera(48, 36, 40.0, 40.0, 23.5, 17.5)


@pytest.fixture(scope="module")
def flat() -> World:
    builder = SceneBuilder(Terrain(np.zeros((41, 41)), 4.0))
    builder.add_ground_material("ground", np.full((64, 64, 3), 128, np.uint8), 1.0)
    builder.add_material("paint", np.full((64, 64, 3), 200, np.uint8))
    builder.add_terrain("ground")
    return builder.compile()


def simulated(flat: World, description: str, x: float, mate: str) -> Simulator:
    config = dataclasses.replace(CONFIG, start=(x, 0.0, 0.0))
    return Simulator(flat, description, config, {mate: description})


def finish(simulator: Simulator) -> None:
    while simulator.is_moving:
        simulator.step(0.1)
        assert simulator.time < 60.0


def body_of(simulator: Simulator) -> RobotBody:
    return simulator._body


def test_a_teammate_stands_where_and_as_its_own_simulation_says(
    flat: World, description: str
) -> None:
    one = simulated(flat, description, 0.0, "two")
    two = simulated(flat, description, 1.2, "one")
    two.follow_arm_trajectory(["arm_pan_joint", "arm_elbow_joint"], [[0.8, 0.3]], [1.0])
    two.follow_base_path([(0.0, 0.0, 0.0), (0.3, 0.0, 0.4)])
    finish(two)

    one.place_teammate("two", two.true_pose(), two.true_joints())

    for link in LINKS:
        seen = body_of(one).data.body(f"two/{link}")
        np.testing.assert_allclose(seen.xpos, two.frame(link)[:3, 3], atol=1e-5)
        turned = np.reshape(seen.xmat, (3, 3))
        np.testing.assert_allclose(turned, two.frame(link)[:3, :3], atol=1e-4)


def test_a_teammate_is_seen_where_it_is(flat: World, description: str) -> None:
    one = simulated(flat, description, 0.0, "two")
    body = body_of(one)
    camera = one.true_camera_pose()
    with Renderer(body.model, CAMERA.width, CAMERA.height) as renderer:
        before = renderer.depth(body.data, camera, CAMERA)
        one.place_teammate("two", one.true_pose() @ ahead(1.2), {})
        after = renderer.depth(body.data, camera, CAMERA)

    nearer = np.nan_to_num(before, nan=99.0) - np.nan_to_num(after, nan=99.0) > 0.1
    assert nearer.sum() > 20
    assert 0.5 < np.median(after[nearer]) < 1.5


def test_images_are_drawn_anew_when_only_a_teammate_has_moved(
    flat: World, description: str
) -> None:
    one = simulated(flat, description, 0.0, "two")
    finish(one)
    before = one.capture().left.astype(float)
    one.place_teammate("two", one.true_pose() @ ahead(1.2), {})
    after = one.capture().left.astype(float)
    one.close()
    assert np.abs(after - before).mean() > 2.0  # noise alone: below 1.5


def test_a_teammate_blocks_and_touching_it_is_forbidden(flat: World, description: str) -> None:
    one = simulated(flat, description, 0.0, "two")
    one.place_teammate("two", one.true_pose() @ ahead(1.2), {})
    one.follow_base_path([(0.0, 0.0, 0.0), (1.5, 0.0, 0.0)])
    finish(one)
    assert one.true_pose()[0, 3] < 1.0
    assert one.contacts > 0
    assert {event.other.split("/")[0] for event in one.contact_events} == {"two"}


def test_a_robot_that_was_not_placed_is_nowhere(flat: World, description: str) -> None:
    one = simulated(flat, description, 0.0, "two")
    one.follow_base_path([(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)])
    finish(one)
    assert one.contacts == 0
    assert body_of(one).data.body("two/base_link").xpos[2] < -100.0


def test_wrong_names_and_starts_are_refused(flat: World, description: str) -> None:
    one = simulated(flat, description, 0.5, "two")
    assert one.true_pose()[0, 3] == pytest.approx(0.5, abs=0.01)
    with pytest.raises(InvalidInputError, match="'three' is unknown; known: two"):
        one.place_teammate("three", np.eye(4), {})
    with pytest.raises(RobotModelError, match="unknown joint: tail"):
        one.place_teammate("two", np.eye(4), {"tail": 1.0})
    with pytest.raises(ConfigError, match="start"):
        SimulatorConfig(start=(1.0, 2.0))


def ahead(distance: float) -> np.ndarray:
    transform = np.eye(4)
    transform[0, 3] = distance
    return transform
