"""What a mission has done so far: survives the process."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError, MissionFileError
from infomap_ros.exploration.robot import KnownPlace, RobotState, planar_pose
from infomap_ros.geometry import check_transform, make_transform
from infomap_ros.geometry.atomic_file import MALFORMED, write_json
from infomap_ros.geometry.transforms import (
    FloatArray,
    quaternion_from_transform,
    transform_from_quaternion,
)

HOME, LAST_LOOK = KnownPlace("home"), KnownPlace("last look")
"""Where nothing is known of them yet; their names stay."""


@dataclass
class Mission:
    """The account of a mission.

    Attributes:
        views: taken so far.
        distance: distance driven so far [m].
        seconds: spent so far [s].
        home: where it began.
        last_look: where the last look succeeded.
        home_pose: ``T_map_base`` at the start, shape (4, 4); empty where not known.
        looks: camera poses of the views, (x, y, z) [m, map] and quaternion (x, y, z, w) each.
    """

    views: int = 0
    distance: float = 0.0
    seconds: float = 0.0
    home: KnownPlace = HOME
    last_look: KnownPlace = LAST_LOOK
    home_pose: list[list[float]] = field(default_factory=list)
    looks: list[list[float]] = field(default_factory=list)

    def note_home(self, state: RobotState) -> None:
        """Keep where it begins."""
        self.home = _place_of(HOME, state)
        self.home_pose = state.T_map_base.tolist()

    def note_success(self, state: RobotState) -> None:
        """Keep from where a look succeeded."""
        self.last_look = _place_of(LAST_LOOK, state)

    def note_look(self, T_map_camera: FloatArray) -> None:
        """Keep the pose of the view just taken, shape (4, 4), where it is not kept yet."""
        if len(self.looks) < self.views:
            numbers = (*T_map_camera[:3, 3], *quaternion_from_transform(T_map_camera))
            self.looks.append([round(float(number), 6) for number in numbers])

    def move(self, T_new_old: FloatArray) -> None:
        """Put all places into the frame to which the map was moved, shape (4, 4)."""
        self.home, self.last_look = (
            replace(place, base=planar_pose(T_new_old @ _pose_at(place.base)))
            if place.is_known
            else place
            for place in (self.home, self.last_look)
        )
        if self.home_pose:
            self.home_pose = (T_new_old @ np.array(self.home_pose)).tolist()
        self.looks = [
            [*map(float, (*pose[:3, 3], *quaternion_from_transform(pose)))]
            for pose in T_new_old @ look_poses(self.looks)
        ]

    def save(self, path: Path) -> None:
        """Write the account, atomically.

        Raises:
            OSError: the file cannot be written.
        """
        write_json(
            path,
            {
                "views": self.views,
                "distance": self.distance,
                "seconds": self.seconds,
                **_place_numbers("home", self.home),
                **_place_numbers("look", self.last_look),
                "home_pose": self.home_pose,
                "looks": self.looks,
            },
        )

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
                read_place(HOME, content["home_base"], content["home_joints"]),
                read_place(LAST_LOOK, content.get("look_base", []), content.get("look_joints", {})),
                _pose_rows(content.get("home_pose", [])),
                [[float(number) for number in look] for look in content.get("looks", [])],
            )
            look_poses(mission.looks)
        except (OSError, *MALFORMED, InvalidInputError) as error:
            raise MissionFileError(f"mission file {path}: {error!r}") from error
        numbers = (mission.views, mission.distance, mission.seconds)
        if not all(map(math.isfinite, numbers)) or min(numbers) < 0.0:
            raise MissionFileError(f"mission file {path}: holds impossible numbers")
        return mission


def read_place(kind: KnownPlace, base: Sequence[float], joints: Mapping[str, float]) -> KnownPlace:
    """A place of a kind, with what was read from a file or a message.

    Args:
        kind: has its name.
        base: (x, y, yaw) [m, rad], or nothing.
        joints: positions by name [rad or m].

    Raises:
        ValueError: a number is not finite, or the base is not a pose.
    """
    place = KnownPlace(
        kind.name,
        tuple(float(number) for number in base),
        {str(name): float(q) for name, q in joints.items()},
    )
    if len(place.base) not in (0, 3):
        raise ValueError(f"{kind.name} is not (x, y, yaw)")
    if not all(map(math.isfinite, (*place.base, *place.joints.values()))):
        raise ValueError(f"{kind.name} is not finite")
    return place


def _pose_at(base: Sequence[float]) -> FloatArray:
    """Level pose of a base at (x, y, yaw), shape (4, 4)."""
    x, y, yaw = base
    return make_transform(Rotation.from_euler("z", yaw).as_matrix(), (x, y, 0.0))


def _place_of(kind: KnownPlace, state: RobotState) -> KnownPlace:
    return KnownPlace(kind.name, planar_pose(state.T_map_base), dict(state.joints))


def _place_numbers(kind: str, place: KnownPlace) -> dict[str, object]:
    return {f"{kind}_base": list(place.base), f"{kind}_joints": dict(place.joints)}


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
