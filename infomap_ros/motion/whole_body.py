"""What reaching needs to know of a robot, whatever the map: found out once and kept.

And how far a body must keep from things because it is not known exactly where it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, PlacedSolid, check_covariance, check_transform, skew
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.arm_path import ArmPathConfig, TrajectoryConfig
from infomap_ros.motion.arm.arm_postures import (
    ArmPostures,
    OwnView,
    compact_postures,
    driving_posture,
)
from infomap_ros.motion.base.drive_space import BasePlannerConfig
from infomap_ros.motion.base.path_following import PathFollowingConfig
from infomap_ros.motion.base.vehicle import Vehicle, VehicleConfig
from infomap_ros.motion.collision.body import CollisionBody, CollisionConfig
from infomap_ros.motion.collision.pair_study import is_any_of
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.robot.robot_model import RobotModel

_RIM = 8  # directions in which the rim of the body is asked
# So many standard deviations of where a body is are added to its margin, in squares, up to these
# margins of base and arm [m].
_MARGIN_SIGMAS, _MAX_BASE_MARGIN, _MAX_ARM_MARGIN = 2.0, 0.08, 0.03
_STEP = 0.01  # [m]; vehicles of a few margins are made and remembered


def base_sigma(
    T_map_camera: ArrayLike, covariance: ArrayLike, T_map_base: ArrayLike, radius: float
) -> float:
    """How well it is known where a robot's body is, as its camera's pose tells.

    A pose error (dt, dtheta) shifts a point p of the robot by ``dt + dtheta x (p - c)``, c being
    the camera's position.

    Args:
        T_map_camera: shape (4, 4).
        covariance: of that pose, shape (6, 6), convention of `geometry.transforms`.
        T_map_base: shape (4, 4).
        radius: of the body about the base's origin [m].

    Returns:
        Largest standard deviation, in any level direction, of a point of the body's rim [m].

    Raises:
        InvalidInputError: not rigid transforms, not a covariance, or a negative radius.
    """
    camera = check_transform(T_map_camera, "T_map_camera")[:3, 3]
    base = check_transform(T_map_base, "T_map_base")
    spread = check_covariance(covariance, 6, "covariance")
    if not radius >= 0.0:
        raise InvalidInputError("radius", f"is {radius}, expected at least 0 m")
    largest = 0.0
    for angle in np.linspace(0.0, 2.0 * math.pi, _RIM, endpoint=False):
        rim = base @ (radius * math.cos(angle), radius * math.sin(angle), 0.0, 1.0)
        level = np.hstack([np.eye(3), -skew(rim[:3] - camera)])[:2]
        variances = np.linalg.eigvalsh(level @ spread @ level.T)
        largest = max(largest, float(variances[-1]))
    return math.sqrt(largest)


def widenings_for(config: VehicleConfig | CollisionConfig, sigma: float) -> list[float]:
    """By how much a body is to be taken for wider, the wanted first, down to 0 for a sure pose.

    The errors that the margin is for and those of the pose are independent, so that their squares
    are added. Whole steps of 1 cm are taken, the nearest.

    Args:
        config: of the vehicle or of the arm.
        sigma: of its position, from `base_sigma` [m].

    Returns:
        One or more, falling [m].
    """
    least = config.margin
    largest = _MAX_BASE_MARGIN if isinstance(config, VehicleConfig) else _MAX_ARM_MARGIN
    wanted = min(math.hypot(least, _MARGIN_SIGMAS * sigma), max(largest, least))
    steps = round((wanted - least) / _STEP)
    return [_STEP * step for step in range(steps, -1, -1)]


@dataclass(frozen=True)
class ReachingConfig:
    """How near a view must be reached, and with how much effort.

    Raises:
        ConfigError: a value is out of its range.
    """

    position_tolerance: float = setting(
        0.05, "A view counts as reached when the camera is this near to it.", unit="m",
        low=1e-4, high=10.0,
    )  # fmt: skip
    direction_tolerance: ClassVar[float] = 0.1
    """And when its viewing direction differs by no more than this; the roll is free [rad]."""
    postures: int = setting(
        30000, "Random postures of the arm from which places for the base are derived.",
        low=100, high=10**7,
    )  # fmt: skip
    stances: ClassVar[int] = 400
    """Places for the base that are looked at for one view."""
    goals: ClassVar[int] = 5
    """Of these, the nearest good ones that are given to the planner of the base."""
    min_approach: ClassVar[float] = 0.3
    """A path that does not lead to the view is offered where it brings the base nearer by more
    than this [m].
    """
    clear_body: ClassVar[float] = 0.05
    """Space within this of the robot's present body is free though it was never seen [m]."""
    driving_posture: tuple[float, ...] = parameter(
        (), "Positions of the arm's joints while the base drives; a compact posture is looked for "
        "where empty.", unit="rad or m",
    )  # fmt: skip
    collision: CollisionConfig = field(default_factory=CollisionConfig)
    arm_path: ArmPathConfig = field(default_factory=ArmPathConfig)
    trajectory: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    vehicle: VehicleConfig = field(default_factory=VehicleConfig)
    base: BasePlannerConfig = field(default_factory=BasePlannerConfig)
    following: PathFollowingConfig = field(default_factory=PathFollowingConfig)

    def __post_init__(self) -> None:
        check_config(self)


_ROUNDING = 2  # decimals of the positions of joints that are not the arm's
_COMPACT = 40  # postures
SAME_POSTURE = 1e-3  # [rad or m]
_SPARE = 0.1  # [m]; beyond the farthest sampled point of the body


@dataclass(frozen=True, eq=False)
class WholeBody:
    """A robot as reaching sees it.

    Attributes:
        robot: the model.
        body: its collision body.
        vehicle: how it stands and drives, the arm in the driving posture.
        postures: of the arm.
        driving: posture while the base drives, shape (n,) [rad or m].
        foot: solids of the links that the arm's first joints move, in the driving posture, base
            frame.
        origin_height: of the base's origin above level ground [m].
        radius: no point of the body is farther from the base's origin [m].
        arm_reach: farthest that the camera is from the base's origin [m].
        own_view: what the camera sees of the robot; None where no camera is known.
    """

    robot: RobotModel
    body: CollisionBody
    vehicle: Vehicle
    postures: ArmPostures
    driving: FloatArray
    foot: tuple[PlacedSolid, ...]
    origin_height: float
    radius: float
    arm_reach: float
    own_view: OwnView | None = None

    @property
    def chain(self) -> KinematicChain:
        """The joints of the arm."""
        return self.body.chain

    @property
    def base_radius(self) -> float:
        """How far what drives reaches from the base's origin, the arm in its posture for it [m]."""
        return float(self.vehicle.arrays.reach)

    def wider_vehicle(self, by: float) -> Vehicle:
        """The vehicle with a body that is wider to all sides [m]."""
        return _wider(self.vehicle, by)

    @cached_property
    def compact(self) -> FloatArray:
        """Postures to drive in where the driving one is blocked, the best first, shape (K, n)."""
        return compact_postures(self.body, _COMPACT)

    def driving_in(self, q: FloatArray) -> WholeBody:
        """The same robot, which drives in another posture, shape (n,), with its footprint."""
        if np.abs(q - self.driving).max(initial=0.0) < SAME_POSTURE:
            return self
        return _driving_in(self, tuple(q.tolist()))

    def sees_past_itself(self, qs: FloatArray) -> NDArray[np.bool_]:
        """In which postures, shape (M, n), not too much of the image is the robot, shape (M,)."""
        if self.own_view is None:
            return np.ones(len(qs), np.bool_)
        return self.own_view.covered(qs) <= self.postures.most_covered

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        config: ReachingConfig,
        joints: Mapping[str, float],
        camera: PinholeCamera | None = None,
    ) -> WholeBody:
        """Find out about a robot, or remember it.

        Joints that are not of the arm, such as those of a gripper or of a second arm, count as
        they stand; those of wheels, which turn all the time, do not.

        Args:
            robot: with a camera frame.
            config: how it reaches.
            joints: positions by name [rad or m].
            camera: to take no postures for views in which the image shows the robot itself.

        Raises:
            ConfigError: the configured driving posture does not fit the arm.
            RobotModelError: the robot has no camera frame or nothing to stand on.
        """
        body = _joints_of_body(robot, config.collision.ground_links)
        others = sorted(body.intersection(joints).difference(robot.arm.joint_names))
        held = {name: round(float(joints[name]), _ROUNDING) for name in others}
        return _whole_body(robot, config, tuple(held.items()), camera)


@lru_cache(maxsize=4)
def _joints_of_body(robot: RobotModel, ground_links: tuple[str, ...]) -> frozenset[str]:
    """Joints that move the camera or a link which does not stand on the ground."""
    links = {link for link in robot.links_with_solids if not is_any_of(link, ground_links)}
    return robot.joints_above(links | {robot.camera_frame})


@lru_cache(maxsize=4)
def _whole_body(
    robot: RobotModel,
    config: ReachingConfig,
    held: tuple[tuple[str, float], ...],
    camera: PinholeCamera | None,
) -> WholeBody:
    body = CollisionBody.from_robot(robot, config.collision, dict(held))
    own_view = None if camera is None else OwnView.of(body, camera)
    postures = ArmPostures.of(body, config.postures, own_view)
    driving = _driving(body, config)
    vehicle = Vehicle.from_robot(
        body.robot, config.vehicle, {**dict(held), **body.chain.by_name(driving)}
    )
    sample = np.concatenate([body.spheres(q, np.eye(4)) for q in postures.q[:500]])
    distances = np.linalg.norm(sample[:, :3], axis=1) + sample[:, 3]
    return WholeBody(
        robot=body.robot,
        body=body,
        vehicle=vehicle,
        postures=postures,
        driving=driving,
        foot=_foot(body, {**dict(held), **body.chain.by_name(driving)}),
        origin_height=-float(vehicle.arrays.contacts[..., 2].min()),
        radius=float(distances.max()) + _SPARE,
        arm_reach=float(np.linalg.norm(postures.positions, axis=1).max()) + _SPARE,
        own_view=own_view,
    )


@lru_cache(maxsize=16)
def _driving_in(whole: WholeBody, q: tuple[float, ...]) -> WholeBody:
    vehicle = whole.vehicle.with_joints(whole.chain.by_name(np.array(q)))
    foot = _foot(whole.body, vehicle.joint_positions)
    return replace(whole, vehicle=vehicle, driving=np.array(q), foot=foot)


@lru_cache(maxsize=16)
def _wider(vehicle: Vehicle, by: float) -> Vehicle:
    if by == 0.0:
        return vehicle
    return Vehicle.from_robot(vehicle.robot, vehicle.config, vehicle.joint_positions, by)


def _foot(body: CollisionBody, joints: Mapping[str, float]) -> tuple[PlacedSolid, ...]:
    robot, bodies, parents = body.robot, body.arrays.bodies, body.tree.arrays.parents
    positions = {j.name: float(np.clip(0.0, j.lower, j.upper)) for j in robot.joints} | dict(joints)
    near = {
        link
        for link, number in zip(body.links, bodies, strict=True)
        if number > 0 and parents[number - 1] == 0
    }
    solids = robot.solids_in(robot.base_frame, positions)
    return tuple(solid for solid in solids if solid.name in near)


def _driving(body: CollisionBody, config: ReachingConfig) -> FloatArray:
    given = np.array(config.driving_posture, dtype=np.float64)
    if not len(given):
        return driving_posture(body)
    chain = body.chain
    beyond = len(given) != len(chain) or (given < chain.lower).any() or (given > chain.upper).any()
    if beyond:
        names = ", ".join(chain.joint_names)
        raise ConfigError(
            "driving_posture", config.driving_posture, f"positions within the limits of {names}"
        )
    return given
