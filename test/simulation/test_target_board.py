"""The target board of the worlds, found in the robot's own images by OpenCV alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.localization.target.tag_board import TagBoard
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.simulation.worlds.scenes import make_world
from infomap_ros.simulation.worlds.target_board import WORLD_BOARD
from infomap_ros.stereo import StereoRectifier


def detected_corners(image: np.ndarray) -> dict[int, np.ndarray]:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36H11)
    corners, ids, _ = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(image)
    if ids is None:
        return {}
    return {int(i): c.reshape(4, 2) for i, c in zip(np.ravel(ids), corners, strict=True)}


def board_pose(image: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """``T_camera_target`` by PnP, shape (4, 4)."""
    board = TagBoard(WORLD_BOARD)
    found = detected_corners(image)
    assert set(found) <= set(board.ids) and len(found) >= 2
    seen = [board.ids.index(tag) for tag in found]
    points, pixels = board.corners[seen].reshape(-1, 3), np.concatenate(list(found.values()))
    _, rotation, translation = cv2.solvePnP(points, pixels, camera, None)
    return make_transform(cv2.Rodrigues(rotation)[0], translation.ravel())


@pytest.mark.parametrize("name", ["mars", "office", "cave"])
def test_board_stands_where_the_world_says_in_view_of_the_start(name: str) -> None:
    world = make_world(name, 3)
    simulator = Simulator(world, read_description(find_share("config/rover.urdf")))
    rectifier = StereoRectifier(*simulator.calibrations)
    pair = simulator.capture()
    simulator.close()
    left, _ = rectifier.rectify(pair.left, pair.right)
    assert world.T_world_target is not None
    np.testing.assert_allclose(world.T_world_target[:3, :3], np.diag([-1, -1, 1]), atol=1e-12)
    truth = invert_transform(simulator.true_camera_pose()) @ world.T_world_target
    off = invert_transform(truth) @ board_pose(left, rectifier.rig.left.matrix)
    assert np.linalg.norm(off[:3, 3]) < 0.02
    assert np.linalg.norm(cv2.Rodrigues(off[:3, :3])[0]) < 0.05


def test_worlds_can_do_without() -> None:
    assert make_world("mars", 3, target_distance=0.0).T_world_target is None
    assert make_world("office", 3, target=False).T_world_target is None
