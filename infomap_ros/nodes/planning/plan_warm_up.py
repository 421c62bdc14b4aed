"""Compile what choosing a view and planning the route there takes, before it is needed."""

from __future__ import annotations

import functools

import numpy as np

from infomap_ros.exploration.robot import KnownPlace, RobotState
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_planner import ViewPlanner, ViewPlannerConfig
from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.geometry.resources import find_share
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.views.next_best_view import NextBestViewConfig
from infomap_ros.views.sampling.candidates import CandidateConfig

_CAMERA = PinholeCamera(64, 48, 40.0, 40.0, 31.5, 23.5)
_ROOM = np.array([[-2.0, -2.0, -0.08], [3.0, 2.0, 1.5]])  # corners, base frame [m]
_BASELINE = 0.1  # [m]
_PANS = np.arange(-2.8, 2.9, 0.7)  # of the arm [rad]
_TILT = 0.5  # [rad]
_AWAY = (0.8, 0.0, 0.5)  # a place to drive to: x, y [m], yaw [rad]


@functools.cache
def warm_up(config: ViewPlannerConfig) -> None:
    """Have the rover that comes with the package choose a view in a room, and drive.

    Once in a process: a second call with the same configuration does nothing.

    Args:
        config: strategy, metric, prediction of the unknown and threads are taken from it.

    Raises:
        InfomapError: there is no such strategy or metric.
    """
    text = find_share("config/rover.urdf").read_text(encoding="utf-8")
    robot = RobotModel.from_urdf(text, "left_camera_optical_frame", "base_link")
    joints = {joint.name: 0.0 for joint in robot.joints}
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    for pan in _PANS:
        posture = {**joints, "arm_pan_joint": float(pan), "arm_wrist_joint": _TILT}
        T_map_camera = robot.forward_kinematics(posture, robot.camera_frame)
        for _ in range(2):  # what two scans see through is free
            voxel_map.integrate(_scan(T_map_camera), T_map_camera, camera=_CAMERA)
    few = NextBestViewConfig(candidates=CandidateConfig(candidates=100))
    small = ViewPlannerConfig(
        strategy=config.strategy,
        metric=config.metric,
        predict_unknown=config.predict_unknown,
        threads=config.threads,
        arm_views=50,
        choice=few,
    )
    planner = ViewPlanner(robot, StereoRig(_CAMERA, _CAMERA, _BASELINE), TaskConfig(), small)
    state = RobotState(np.eye(4), T_map_camera, 1e-6 * np.eye(6), posture)
    planner.choose(voxel_map, state)
    planner.route_to(voxel_map, state, KnownPlace("away", _AWAY, joints))


def _scan(T_map_camera: FloatArray) -> FloatArray:
    """What the camera measures in the room, shape (48, 64, 3)."""
    rays = _CAMERA.back_project(np.ones((_CAMERA.height, _CAMERA.width))).astype(np.float64)
    directions = rays @ T_map_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        walls = (np.where(directions > 0.0, _ROOM[1], _ROOM[0]) - T_map_camera[:3, 3]) / directions
    return np.asarray(rays * walls.min(axis=-1, keepdims=True))
