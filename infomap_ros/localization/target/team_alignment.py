"""The relative origin of a team: robots that see each other's tags find one map.

Each sighting tells how the maps of two robots lie to each other (`map_alignment`). Where several
agree, and say that the two maps are not the same, one of the robots puts the frame of its map where
it belongs (`Localizer.move_map`). Where they say that the maps are the same, nothing is to be done.

Other robots seen by the tags that they carry: their pose relative to this one.

This is the relative origin of a team: where no target is common, robots that see each other still
find one frame (`map_alignment`).

How the maps of two robots lie to each other: from a common target, or from seeing each other.

An alignment is ``T_a_b``, the frame of map b in map a, with a covariance in the frame of map a.
Several are fused by least squares on SE(3); one that contradicts the others is found by its
normalized distance (chi-square with six degrees of freedom), before anything is merged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import check_covariance, check_transform, compose_poses
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray, perturb_transform
from infomap_ros.localization.target.tag_board import TagBoardConfig
from infomap_ros.localization.target.tag_detection import TagFinder
from infomap_ros.localization.target.tag_detector import (
    TagTargetConfig,
    TagTargetDetector,
    own_tags,
)
from infomap_ros.localization.target.target import TargetRefusal, invert_pose

if TYPE_CHECKING:
    from infomap_ros.localization.fiducials.range_view import RangeView


CONTRADICTION = 22.5
"""Squared normalized distance of six numbers that one in a thousand honest pairs exceeds."""

_ITERATIONS = 10
_ROUNDING = 1e-15  # relative size below which an eigenvalue may be none


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where map b is in map a.

    Attributes:
        T_a_b: shape (4, 4).
        covariance: in the frame of map a, shape (6, 6).

    Raises:
        InvalidInputError: the pose is not rigid or the covariance is none.
    """

    T_a_b: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_a_b", check_transform(self.T_a_b, "T_a_b"))
        object.__setattr__(self, "covariance", check_covariance(self.covariance, 6))

    def inverse(self) -> Alignment:
        """Where map a is in map b."""
        return Alignment(*invert_pose(self.T_a_b, self.covariance))

    def then(self, following: Alignment) -> Alignment:
        """Chain ``T_a_b`` and ``T_b_c`` to ``T_a_c``; their errors are independent."""
        first, second = (self.T_a_b, self.covariance), (following.T_a_b, following.covariance)
        return Alignment(*compose_poses(*first, *second))


def align_by_sighting(base_a: Alignment, other: Alignment, base_b: Alignment) -> Alignment:
    """Alignment of the maps of two robots of which one sees the other's tags.

    Args:
        base_a: robot a's base in map a.
        other: robot b's base in robot a's base frame, as `RobotSighting` tells.
        base_b: robot b's base in map b, at the same stamp.
    """
    return base_a.then(other).then(base_b.inverse())


def has_scale(alignment: Alignment) -> bool:
    """Whether every direction has an error, so that two such alignments can be weighed."""
    values = np.linalg.eigvalsh(alignment.covariance)
    return bool(values[0] > _ROUNDING * values[-1])


def squared_distance(first: Alignment, second: Alignment) -> float:
    """How far apart two independent alignments of the same maps are, squared, in sigmas.

    Raises:
        InvalidInputError: both are exact, so that no difference has a scale.
    """
    error = _difference(first.T_a_b, second.T_a_b)
    total = first.covariance + second.covariance
    if np.linalg.eigvalsh(total)[0] <= 0.0:
        raise InvalidInputError("covariance", "the sum of both is singular")
    return float(error @ np.linalg.solve(total, error))


@dataclass(frozen=True, eq=False)
class FusedAlignment:
    """What several alignments say together.

    Attributes:
        alignment: their weighted mean, of those that agree.
        agreeing: which ones took part, shape (N,).
        is_consistent: whether more than half of them do.
    """

    alignment: Alignment
    agreeing: NDArray[np.bool_]
    is_consistent: bool


def fuse_alignments(
    alignments: Sequence[Alignment], contradiction: float = CONTRADICTION
) -> FusedAlignment:
    """Fuse independent alignments of the same two maps.

    The one with which most others agree leads; those that contradict it are left out.

    Args:
        alignments: at least one, with covariances that are not singular.
        contradiction: squared normalized distance above which two contradict each other.

    Raises:
        InvalidInputError: there is none, or one has a covariance that is singular.
    """
    if not alignments:
        raise InvalidInputError("alignments", "is empty")
    if not all(map(has_scale, alignments)):
        raise InvalidInputError("alignments", "one has a singular covariance")
    apart = np.array(
        [[0.0 if a is b else squared_distance(a, b) for b in alignments] for a in alignments]
    )
    agree = apart <= contradiction
    leader = int(np.lexsort((apart.sum(axis=1), -agree.sum(axis=1)))[0])
    mask = agree[leader]
    used = [one for one, fits in zip(alignments, mask, strict=True) if fits]
    fused = _mean(used, alignments[leader].T_a_b)
    return FusedAlignment(fused, mask, 2 * int(mask.sum()) > len(alignments))


def _mean(alignments: Sequence[Alignment], start: FloatArray) -> Alignment:
    """Weighted least squares on SE(3)."""
    weights = [np.linalg.inv(one.covariance) for one in alignments]
    information = np.sum(weights, axis=0)
    pose = start
    for _ in range(_ITERATIONS):
        errors = [_difference(pose, one.T_a_b) for one in alignments]
        pull = np.sum([w @ e for w, e in zip(weights, errors, strict=True)], axis=0)
        step = np.linalg.solve(information, pull)
        pose = perturb_transform(pose, step)
        if np.abs(step).max() < 1e-12:
            break
    return Alignment(pose, np.linalg.inv(information))


def _difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """Pose error, shape (6,), that takes the first pose to the second."""
    turn = Rotation.from_matrix(second[:3, :3] @ first[:3, :3].T).as_rotvec()
    return np.concatenate([second[:3, 3] - first[:3, 3], turn])


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
        self._finder = TagFinder(families.pop()) if families else None

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
        tags = self._finder.look(view)
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


_POSE = 6  # numbers
_EXACT = Alignment(np.eye(4), np.zeros((_POSE, _POSE)))


@dataclass(frozen=True)
class TeamTagsConfig:
    """Which tags sit on which robots of the team, and where.

    Raises:
        ConfigError: a value is out of its range, or the lists do not fit each other.
    """

    robots: tuple[int, ...] = parameter(
        (), "For each tag of the team the robot_id of the robot that carries it; none where empty."
    )
    ids: tuple[int, ...] = parameter((), "For each tag its id.")
    poses: tuple[float, ...] = parameter(
        (),
        "For each tag six numbers: its middle [m] and its rotation vector [rad] in the base frame "
        "of its robot; a tag's own axes are x right and y up in the print, z out of it.",
    )
    family: str = setting("tag36h11", "Family of the tags.")
    side: float = parameter(
        0.16, "Edge of the black square of one tag.", unit="m", low=0.005, high=5.0
    )

    def __post_init__(self) -> None:
        check_config(self)
        if len(self.ids) != len(self.robots):
            raise ConfigError("ids", self.ids, f"one id for each of {len(self.robots)} robots")
        if len(self.poses) != _POSE * len(self.robots):
            raise ConfigError("poses", self.poses, f"six numbers for each of {len(self.ids)} tags")
        self.carried()

    def carried(self, but: int | None = None) -> list[RobotTags]:
        """The tags of each robot, named by its id.

        Args:
            but: id of a robot that is left out: that which looks.

        Raises:
            ConfigError: the tags cannot be such tags.
        """
        poses = np.reshape(self.poses, (-1, _POSE))
        found = []
        for robot in sorted(set(self.robots) - {but}):
            own = [place for place, carrier in enumerate(self.robots) if carrier == robot]
            ids, flat = tuple(self.ids[i] for i in own), tuple(map(float, poses[own].ravel()))
            board = TagBoardConfig(family=self.family, side=self.side, ids=ids, poses=flat)
            found.append(RobotTags(str(robot), TagTargetConfig(board=board)))
        return found


class TeamAlignment:
    """Learns from sightings how the map of a teammate lies to the own one.

    Args:
        sightings: that must agree.

    Attributes:
        problem: why the last sightings gave nothing; empty where they did.
    """

    def __init__(self, sightings: int) -> None:
        self._wanted, self.problem = sightings, ""
        self._recent: list[Alignment] = []

    def clear(self) -> None:
        """Forget all sightings, as when a map was moved."""
        self._recent.clear()

    def add(self, T_theirs_mine: Alignment, is_one_frame: bool = True) -> Alignment | None:
        """Learn from one sighting; one whose covariance is singular gives nothing.

        Repeated sightings share errors, those of the two robots' own poses. So they are no surer
        together than the surest of them.

        Args:
            T_theirs_mine: what it says.
            is_one_frame: whether the maps are said to be in one frame; else they are not the same,
                however near they are.

        Returns:
            ``T_theirs_mine`` when the maps are not the same and enough sightings agree on it.
        """
        if not has_scale(T_theirs_mine):
            self.problem = "a sighting without an error in some direction"
            return None
        self.problem = ""
        self._recent = [*self._recent[1 - self._wanted :], T_theirs_mine][-self._wanted :]
        if len(self._recent) < self._wanted:
            return None
        fused = fuse_alignments(self._recent)
        self.problem = "" if fused.is_consistent else "sightings contradict each other"
        if not fused.is_consistent:
            return None
        agreeing = [one for one, fits in zip(self._recent, fused.agreeing, strict=True) if fits]
        surest = min(agreeing, key=lambda one: float(np.linalg.slogdet(one.covariance)[1]))
        found = Alignment(fused.alignment.T_a_b, surest.covariance)
        is_same = is_one_frame and squared_distance(found, _EXACT) <= CONTRADICTION
        return None if is_same else found
