"""Other robots seen by the tags that they carry: their pose relative to this one.

This is the relative origin of a team: where no target is common, robots that see each other still
find one frame (`map_alignment`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import check_covariance, check_transform, compose_poses
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoardConfig
from infomap_ros.localization.target.tag_detection import TagFinder
from infomap_ros.localization.target.tag_detector import (
    TagTargetConfig,
    TagTargetDetector,
    own_tags,
)
from infomap_ros.localization.target.target import TargetRefusal

if TYPE_CHECKING:
    from infomap_ros.localization.fiducials.range_view import RangeView


@dataclass(frozen=True)
class RobotTags:
    """The tags on one robot.

    Attributes:
        robot: its name.
        tags: which tags, and where: ``tags.board.poses`` are in the robot's base frame.

    Raises:
        ConfigError: the robot has no name, or its tags have no poses.
    """

    robot: str
    tags: TagTargetConfig = field(default_factory=TagTargetConfig)

    def __post_init__(self) -> None:
        if not self.robot:
            raise ConfigError("robot", self.robot, "a name")
        if not self.tags.board.poses:
            raise ConfigError("poses", self.tags.board.poses, "where on the robot each tag is")


@dataclass(frozen=True, eq=False)
class RobotSighting:
    """Where another robot is.

    Attributes:
        stamp: of the image [ns].
        robot: its name.
        T_base_other: pose of its base in the base frame of the robot that sees it, shape (4, 4).
        covariance: in the frame of the base that sees, shape (6, 6).
        score: from 0 to 1, share of the tags found on it that agree.
    """

    stamp: int
    robot: str
    T_base_other: FloatArray
    covariance: FloatArray
    score: float


class RobotTagFinder:
    """Finds robots by their tags.

    Args:
        robots: the team's tags; of one family, each id on one robot only.

    Raises:
        ConfigError: families differ, or an id or a name occurs twice.
    """

    def __init__(self, robots: Sequence[RobotTags]) -> None:
        boards: list[TagBoardConfig] = [one.tags.board for one in robots]
        families = {board.family for board in boards}
        if len(families) > 1:
            raise ConfigError("family", sorted(families), "one family for all robots")
        self._detectors = {one.robot: TagTargetDetector(one.tags) for one in robots}
        if len(self._detectors) < len(robots):
            raise ConfigError("robot", [one.robot for one in robots], "a different name for each")
        ids = [tag for one in self._detectors.values() for tag in one.board.ids]
        if len(set(ids)) < len(ids):
            raise ConfigError("ids", sorted(ids), "each tag on one robot only")
        first = robots[0].tags.detection if robots else None
        self._finder = TagFinder(families.pop(), first) if families else None

    def find(
        self, view: RangeView, T_base_camera: ArrayLike, covariance: ArrayLike | None = None
    ) -> tuple[list[RobotSighting], dict[str, TargetRefusal]]:
        """Find the robots in a view.

        Args:
            view: image and range.
            T_base_camera: where the camera is on the robot that sees, shape (4, 4).
            covariance: of that, in the base frame, shape (6, 6); exact where None.

        Returns:
            The robots that were found, and why others of which tags were seen were refused.

        Raises:
            InvalidInputError: the pose or the covariance is none.
        """
        mount = check_transform(T_base_camera, "T_base_camera")
        spread = np.zeros((6, 6)) if covariance is None else check_covariance(covariance, 6)
        if self._finder is None:
            return [], {}
        tags = self._finder.find(view.image)
        found, refused = [], {}
        for robot, detector in self._detectors.items():
            own = own_tags(tags, detector.board)
            if not len(own.ids):
                continue
            result = detector.locate(own, view)
            if isinstance(result, TargetRefusal):
                refused[robot] = result
                continue
            pose = compose_poses(mount, spread, result.T_camera_target, result.covariance)
            found.append(RobotSighting(view.stamp, robot, *pose, result.score))
        return found, refused


def tag_pose(center: ArrayLike, facing: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> FloatArray:
    """Six numbers of a tag on a robot, for `TagBoardConfig.poses`.

    Args:
        center: of the tag in the base frame, shape (3,) [m].
        facing: direction out of the print in the base frame, shape (3,).
        up: direction to the top of the print, shape (3,); need not be square to `facing`.

    Returns:
        Place [m] and rotation vector [rad], shape (6,).

    Raises:
        InvalidInputError: `up` is along `facing`, or one of them is zero.
    """
    z = np.asarray(facing, dtype=np.float64)
    x = np.cross(np.asarray(up, dtype=np.float64), z)
    if np.linalg.norm(x) < 1e-9 or not np.isfinite(x).all():
        raise InvalidInputError("up", "is along facing, or one of them is zero")
    z, x = z / np.linalg.norm(z), x / np.linalg.norm(x)
    turn = Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z]))
    return np.concatenate([np.asarray(center, dtype=np.float64), turn.as_rotvec()])
