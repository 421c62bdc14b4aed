"""What a mission has done so far: survives the process."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from infomap_ros.errors import InvalidInputError, MissionFileError
from infomap_ros.geometry import check_transform
from infomap_ros.geometry.atomic_file import write_json
from infomap_ros.geometry.transforms import (
    FloatArray,
    quaternion_from_transform,
    transform_from_quaternion,
)


@dataclass
class Mission:
    """The account of a mission.

    Attributes:
        views: taken so far.
        distance: way of the base so far [m].
        seconds: spent so far [s].
        home_base: base pose at the start (x, y, yaw) [m, rad]; empty before the start.
        home_joints: joint positions at the start [rad or m].
        home_pose: ``T_map_base`` at the start, shape (4, 4); empty where not known.
        looks: camera poses of the views, (x, y, z) [m, map] and quaternion (x, y, z, w) each.
    """

    views: int = 0
    distance: float = 0.0
    seconds: float = 0.0
    home_base: list[float] = field(default_factory=list)
    home_joints: dict[str, float] = field(default_factory=dict)
    home_pose: list[list[float]] = field(default_factory=list)
    looks: list[list[float]] = field(default_factory=list)

    def note_look(self, T_map_camera: FloatArray) -> None:
        """Keep the pose of the view just taken, shape (4, 4), where it is not kept yet."""
        if len(self.looks) < self.views:
            numbers = (*T_map_camera[:3, 3], *quaternion_from_transform(T_map_camera))
            self.looks.append([round(float(number), 6) for number in numbers])

    def save(self, path: Path) -> None:
        """Write the account, atomically.

        Raises:
            OSError: the file cannot be written.
        """
        write_json(path, dataclasses.asdict(self))

    @classmethod
    def load(cls, path: Path) -> Mission:
        """Read an account that `save` wrote.

        Raises:
            MissionFileError: the file is missing, malformed, or holds impossible numbers.
        """
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            mission = cls(
                int(content["views"]),
                float(content["distance"]),
                float(content["seconds"]),
                [float(number) for number in content["home_base"]],
                {str(name): float(q) for name, q in content["home_joints"].items()},
                _pose_rows(content.get("home_pose", [])),
                [[float(number) for number in look] for look in content.get("looks", [])],
            )
            look_poses(mission.looks)
        except (
            OSError,
            ValueError,
            KeyError,
            TypeError,
            AttributeError,
            InvalidInputError,
        ) as error:
            raise MissionFileError(f"mission file {path}: {error!r}") from error
        numbers = (
            mission.views,
            mission.distance,
            mission.seconds,
            *mission.home_base,
            *mission.home_joints.values(),
        )
        if not all(map(math.isfinite, numbers)) or min(numbers[:3]) < 0.0:
            raise MissionFileError(f"mission file {path}: holds impossible numbers")
        if len(mission.home_base) not in (0, 3):
            raise MissionFileError(f"mission file {path}: home_base is not (x, y, yaw)")
        return mission


def look_poses(looks: Sequence[Sequence[float]]) -> FloatArray:
    """Camera poses of `Mission.looks`, shape (V, 4, 4).

    Raises:
        InvalidInputError: one is no pose.
        ValueError: one has not seven numbers.
    """
    numbers = np.reshape(np.asarray(looks, dtype=np.float64), (len(looks), 7))
    poses = [transform_from_quaternion(look[3:], look[:3]) for look in numbers]
    return np.reshape(np.array(poses, dtype=np.float64), (len(looks), 4, 4))


def _pose_rows(rows: object) -> list[list[float]]:
    """A pose as lists, shape (4, 4), or none, as an empty list.

    Raises:
        InvalidInputError: it is not a pose.
    """
    if rows == []:
        return []
    poses: list[list[float]] = check_transform(np.array(rows, dtype=np.float64)).tolist()
    return poses
