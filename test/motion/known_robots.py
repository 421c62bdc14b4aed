"""Robots that nobody here designed, with their meshes, from the Python package index."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path
from typing import Any

from infomap_ros.motion.robot.robot_model import RobotModel

TIAGO_ARM = tuple(f"arm_{number}_joint" for number in range(1, 8))

TELESCOPE = {f"joint_arm_l{number}": "joint_arm_l3" for number in range(3)}
"""The segments of Stretch's arm, which one motor drives."""


def installed(package: str, ending: str) -> Path:
    """A file of an installed distribution."""
    files = importlib.metadata.files(package) or []
    return next(Path(str(file.locate())).resolve() for file in files if str(file).endswith(ending))


def panda(**options: Any) -> RobotModel:
    """Franka Panda, 7 joints; the hand stands for a camera."""
    urdf = installed("example-robot-data", "urdf/panda.urdf")
    return example_robot(urdf, "panda_hand", base_frame="panda_link0", **options)


def ur5(**options: Any) -> RobotModel:
    """Universal Robots UR5, 6 joints that turn up to two turns."""
    return example_robot(installed("example-robot-data", "ur5_robot.urdf"), "tool0", **options)


def tiago(**options: Any) -> RobotModel:
    """PAL TIAGo, a lift and 7 joints; the wrist stands for a camera."""
    urdf = installed("example-robot-data", "robots/tiago_no_hand.urdf")
    return example_robot(urdf, "wrist_ft_tool_link", **options)


def stretch(**options: Any) -> RobotModel:
    """Hello Robot Stretch SE3 with the camera at its gripper."""
    urdf = installed("hello-robot-stretch-urdf", "SE3_eoa_wrist_dw3_tool_sg3.urdf")
    return RobotModel.from_urdf(urdf, "gripper_camera_color_optical_frame", **options)


def example_robot(urdf: Path, camera_frame: str, **options: Any) -> RobotModel:
    """A robot of example-robot-data, whose meshes are named by ``package://``."""
    return RobotModel.from_urdf(urdf, camera_frame, package_folders=[urdf.parents[4]], **options)


KNOWN_ROBOTS = {"panda": panda, "ur5": ur5, "tiago": tiago, "stretch": stretch}
