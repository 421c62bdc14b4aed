"""A teammate that drives through the view of a stereo camera leaves no voxel above the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from infomap_ros.exploration.robot import RobotState
from infomap_ros.exploration.team.teammate_places import TeamBodies
from infomap_ros.exploration.team.teamwork import Presence, Teamwork
from infomap_ros.geometry import PlacedSolid, make_transform, points_inside
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.pipeline.range_estimator import RangeMeasurement
from infomap_ros.pipeline.scan_synchronizer import Scan
from infomap_ros.simulation.exploring.simulated_robot import SimulatedRobot, SimulatedRobotConfig
from infomap_ros.simulation.robots.ready_robot import ready_robot
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.scenes import make_world

LOOKS, STEP = 5, 0.6  # [s]
SETUP = SimulatedRobotConfig(pose_source="simulator", image_rate=1.0 / STEP)


def surface_in(voxel_map: VoxelMap, bodies: list[PlacedSolid], floor: float) -> int:
    """Surface voxels more than 5 cm above the floor and at most that far from bodies."""
    means = voxel_map.gaussians()[1]
    means = means[means[:, 2] > floor + 0.05]
    return int(points_inside(means, bodies, 0.05).sum())


def test_a_teammate_that_drives_by_leaves_no_voxel(description: str) -> None:
    config, world = SimulatorConfig(seed=1), make_world("office", 1)
    frames = ready_robot(description, config.robot).setup
    camera_frame, base_frame = frames.left_camera_frame, frames.base_frame
    model = RobotModel.from_urdf(description, camera_frame, base_frame, mimics=frames.leaders)
    one = Simulator(world, description, config, {"two": description})
    here = one.true_pose()
    x, y = (here @ make_transform(np.eye(3), (1.5, -0.6, 0.0)))[:2, 3].tolist()
    two = Simulator(world, description, replace(config, seed=2, start=(x, y, np.pi / 2)))
    uncut = VoxelMap(VoxelMapConfig(voxel_size=0.05, max_range=4.0))
    cut = VoxelMap(uncut.config)

    class Also:
        """Fuses the same scans, with nothing cut."""

        def image_taken(self, stamp: int) -> None:
            pass

        def scan_fused(self, scan: Scan[RangeMeasurement]) -> None:
            cloud = scan.cloud.cloud
            points, covariances = cloud.organized_points, cloud.covariance_triangles
            uncut.integrate(points, scan.pose.transform, covariances, camera=cloud.camera)

    bodies, ours, theirs = TeamBodies(), Teamwork(1, 1, 1), Teamwork(2, 2, 2)
    bodies.describe(2, model)
    robot = SimulatedRobot(one, model, cut, SETUP, Also(), bodies)
    two.follow_base_path([(0.0, 0.0, 0.0), (1.2, 0.0, 0.0)])
    swept: list[PlacedSolid] = []
    for _ in range(LOOKS):
        two.step(STEP)
        pose, joints = two.true_pose(), two.true_joints()
        one.place_teammate("two", pose, joints)
        state = RobotState(pose, two.true_camera_pose(), 1e-6 * np.eye(6), joints)
        at_the_scan = one.stamp + round(STEP * 1e9)
        told = theirs.announcement(Presence(at_the_scan, state, model, robot.link.rig.left, 4.0))
        agent = ours.receive(told.text, 0.0)
        assert agent is not None
        bodies.receive(agent)
        robot.link.let_pass(STEP)
        solids = model.solids_in(base_frame, joints)
        swept += [PlacedSolid(s.solid, pose @ s.transform, s.name) for s in solids]
    one.close()
    assert np.linalg.norm(pose[:2, 3] - (x, y)) > 0.5, "it has driven"
    floor = float(here[2, 3]) - 0.08
    assert surface_in(uncut, swept, floor) > 50
    assert surface_in(cut, swept, floor) == 0
    assert cut.surface_voxels > 0.7 * uncut.surface_voxels
