"""The names and shapes that programs of others are written against."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.motion import BasePlanner, RobotModel, solve_ik
from infomap_ros.stereo import StereoConfig, StereoRangeSensor
from infomap_ros.views import expected_information

FRAME = "left_camera_optical_frame"
ROVER = Path(__file__).resolve().parent.parent / "config" / "rover.urdf"
CAMERA = PinholeCamera(160, 120, 100.0, 100.0, 79.5, 59.5)


def test_a_pair_becomes_points_with_covariances(rng: np.random.Generator) -> None:
    sensor = StereoRangeSensor(StereoRig(CAMERA, CAMERA, 0.1), StereoConfig())
    right = rng.integers(0, 256, (120, 160), dtype=np.uint8)
    cloud = sensor.measure(np.roll(right, 10, axis=1), right)  # a wall 1 m away
    count = len(cloud.points)
    assert count > 1000
    assert (cloud.points.shape, cloud.covariances.shape) == ((count, 3), (count, 3, 3))
    assert cloud.range_image.shape == (120, 160)
    assert np.nanmedian(cloud.points[:, 2]) == pytest.approx(1.0, abs=0.01)


def test_points_become_a_map_that_says_where_to_look(tmp_path: Path) -> None:
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05, max_range=5.0))
    y, z = (a.ravel() for a in np.mgrid[-0.5:0.5:0.02, -0.5:0.5:0.02])
    wall = np.column_stack((y, z, np.full(y.size, 2.0)))
    for _ in range(3):
        voxel_map.integrate(wall, np.eye(4), covariances=None, pose_covariance=None, camera=None)
    assert voxel_map.probability([[0.0, 0.0, 2.0]])[0] > 0.5 > voxel_map.probability([[0, 0, 1]])
    assert voxel_map.is_known([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]]).tolist() == [True, False]
    indices, means, covariances = voxel_map.gaussians()
    count = len(indices)
    assert (means.shape, covariances.shape) == ((count, 3), (count, 3, 3))
    distances, hit = voxel_map.cast_rays([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], 5.0)
    assert hit[0] and distances[0] == pytest.approx(2.0, abs=0.05)
    voxel_map.save(tmp_path / "map.infomap")
    assert VoxelMap.load(tmp_path / "map.infomap").known_voxels == voxel_map.known_voxels
    assert voxel_map.memory_bytes() > 0 and voxel_map.entropy_bits(region=None) > 0.0

    away = np.diag((-1.0, 1.0, -1.0, 1.0))
    information = expected_information(
        voxel_map, np.array((np.eye(4), away)), CAMERA, 5.0, metric="expected_entropy_reduction"
    )
    assert information.shape == (2,) and 0.0 < information[0] < information[1]


def test_a_description_becomes_a_robot_that_reaches() -> None:
    robot = RobotModel.from_urdf(ROVER, camera_frame=FRAME)
    assert RobotModel.from_urdf(ROVER.read_text("utf-8"), camera_frame=FRAME)
    joints = dict.fromkeys(robot.arm.joint_names, 0.1)
    result = solve_ik(robot, robot.forward_kinematics(joints, FRAME))
    assert result.converged and result.q.shape == (len(joints),)
    assert callable(BasePlanner)


@pytest.mark.parametrize("room", ["motion", "views"])
def test_what_is_not_there_is_an_attribute_error(room: str) -> None:
    module = __import__(f"infomap_ros.{room}", fromlist=["x"])
    with pytest.raises(AttributeError, match="has no attribute 'absent'"):
        _ = module.absent
