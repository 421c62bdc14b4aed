"""What the description of a robot does not say and the user knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.motion.robot.robot_model import RobotModel


@dataclass(frozen=True)
class DescriptionConfig:
    """How a robot's URDF is to be read.

    Raises:
        ConfigError: a value is out of its range.
    """

    mimics: tuple[str, ...] = parameter(
        (),
        "Joints that follow another although the URDF does not say so, as 'follower:leader', for "
        "example the segments of a telescope that one motor drives.",
    )
    assumed_joints: tuple[str, ...] = parameter(
        (),
        "Joints that joint_states does not hold, as often those of wheels. They are taken to stand "
        "at zero or at their limit nearest to it.",
    )
    mesh_folders: tuple[str, ...] = parameter(
        (),
        "Folders in which meshes are looked for, besides ROS_PACKAGE_PATH and AMENT_PREFIX_PATH: "
        "those that hold the packages of package:// addresses, or relative paths.",
    )

    def __post_init__(self) -> None:
        check_config(self)
        for pair in self.mimics:
            if pair.count(":") != 1:
                raise ConfigError("mimics", pair, "two joints, as 'follower:leader'")

    def read(
        self,
        path_or_xml: str | Path,
        camera_frame: str = "",
        base_frame: str = "",
        arm_joints: Sequence[str] = (),
    ) -> RobotModel:
        """Read a robot; arguments as for `RobotModel.from_urdf`.

        Raises:
            RobotModelError: the URDF cannot be used, or lacks a joint that is named here.
        """
        return RobotModel.from_urdf(
            path_or_xml,
            camera_frame,
            base_frame,
            package_folders=self.mesh_folders,
            arm_joints=arm_joints,
            mimics=dict(pair.split(":") for pair in self.mimics),
            assumed_joints=self.assumed_joints,
        )
