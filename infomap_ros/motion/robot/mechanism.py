"""The joints of a robot, how positions move them, and the chain of them between two frames."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio
from numpy.typing import NDArray

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.chain import ChainArrays, KinematicChain
from infomap_ros.motion.robot.urdf import Follower


@dataclass(frozen=True)
class JointLimits:
    """A joint that has a position of its own.

    Attributes:
        name: as in the URDF.
        lower: smallest position [rad or m]; -inf for a continuous joint.
        upper: largest position [rad or m]; inf for a continuous joint.
        velocity: largest speed [rad/s or m/s]; inf where the URDF gives none.
        is_continuous: turns without end.
    """

    name: str
    lower: float
    upper: float
    velocity: float
    is_continuous: bool = False

    @property
    def rest(self) -> float:
        """Zero, or the limit nearest to it [rad or m]."""
        return min(max(0.0, self.lower), self.upper)


def joint_limits(model: pinocchio.Model, index: int) -> JointLimits:
    """Limits of one joint of a model, of one degree of freedom.

    Raises:
        RobotModelError: the lower limit is above the upper one.
    """
    name, joint = str(model.names[index]), model.joints[index]
    speed = float(_velocity_limits(model)[joint.idx_v])
    speed = speed if speed > 0.0 else math.inf
    if joint.nq == 2:
        return JointLimits(name, -math.inf, math.inf, speed, True)
    lower, upper = (
        float(x[joint.idx_q]) for x in (model.lowerPositionLimit, model.upperPositionLimit)
    )
    if not lower <= upper:
        raise RobotModelError(f"joint '{name}' has the lower limit {lower:g}, upper {upper:g}")
    return JointLimits(name, lower, upper, speed)


def _velocity_limits(model: pinocchio.Model) -> FloatArray:
    """Largest speeds by velocity index; Pinocchio 3, which ROS has, knows one for both signs."""
    if hasattr(model, "upperVelocityLimit"):
        return np.asarray(model.upperVelocityLimit)
    return np.asarray(model.velocityLimit)


class Mechanism:
    """Joints by index of a Pinocchio model, and positions by name. Immutable.

    The model knows nothing of joints that mimic another: it takes a position of each. Pinocchio's
    own mimicking joints have to come after their leaders and cannot follow a follower.

    Args:
        model: the joints.
        followers: those that mimic another, by name.
        assumed: names of joints whose position may be missing; they stand where they rest.

    Raises:
        RobotModelError: a joint of `assumed` has no position of its own.

    Attributes:
        model: every joint has one degree of freedom; not to be written to.
        indices: index of each joint that has a position of its own, by name, in the model's order.
    """

    def __init__(
        self,
        model: pinocchio.Model,
        followers: Mapping[str, Follower] | None = None,
        assumed: Iterable[str] = (),
    ) -> None:
        self.model = model
        names = {str(name): index for index, name in enumerate(model.names) if index > 0}
        self._followers = {
            names[name]: (names[item.leader], item.factor, item.offset)
            for name, item in (followers or {}).items()
        }
        self.indices = {k: index for k, index in names.items() if index not in self._followers}
        self._limits = {name: joint_limits(model, index) for name, index in self.indices.items()}
        for name in assumed:
            if name not in self.indices:
                raise RobotModelError(f"there is no joint '{name}' whose position can be assumed")
        self._assumed = {
            name: limits.rest
            for name, limits in self._limits.items()
            if name in assumed or limits.lower == limits.upper
        }

    @property
    def joints(self) -> tuple[JointLimits, ...]:
        """The joints that have a position of their own, in the model's order."""
        return tuple(self._limits.values())

    def owner_of(self, index: int) -> int:
        """The joint whose position moves this one: itself, or the one that it mimics."""
        return self._followers.get(index, (index, 1.0, 0.0))[0]

    def scaling_of(self, index: int) -> tuple[float, float]:
        """Factor and offset from the position of `owner_of` to that of the joint."""
        return self._followers.get(index, (index, 1.0, 0.0))[1:]

    def limits_of(self, index: int) -> JointLimits:
        """Limits of a joint that has a position of its own."""
        return self._limits[str(self.model.names[index])]

    def slides(self, index: int) -> bool:
        """Whether the joint is prismatic."""
        return str(self.model.joints[index].shortname()).startswith("JointModelP")

    def above(self, joints: Iterable[int]) -> frozenset[int]:
        """All joints, those that mimic included, that carry these, with themselves."""
        return frozenset(int(index) for joint in joints for index in self.model.supports[joint]) - {
            0
        }

    def owners(self, joints: Iterable[int]) -> frozenset[str]:
        """Names of the joints whose positions move any of these."""
        return frozenset(str(self.model.names[self.owner_of(index)]) for index in joints)

    def configuration(self, positions: Mapping[str, float], needed: Iterable[str]) -> FloatArray:
        """Pinocchio's configuration, shape (nq,); joints that are not needed stand at zero.

        Args:
            positions: by name [rad or m]; unknown names are ignored.
            needed: names of joints that must be there.

        Raises:
            RobotModelError: a needed joint is missing or its position is not finite; names it.
        """
        known = {**self._assumed, **positions}
        missing = [name for name in needed if name not in known]
        if missing:
            names = ", ".join(map(repr, sorted(missing)))
            raise RobotModelError(
                f"no position of joint {names}; if nobody reports it, name it in assumed_joints"
            )
        return self._written({name: known[name] for name in needed})

    def resting(self, held: Mapping[str, float]) -> FloatArray:
        """Pinocchio's configuration, shape (nq,), with all joints at rest but those of `held`.

        Args:
            held: by name [rad or m]; the others stand at zero or at their limit nearest to it.

        Raises:
            RobotModelError: a position of `held` is not finite or is that of an unknown joint.
        """
        for name in held:
            if name not in self.indices:
                raise RobotModelError(f"joint '{name}' has no position that can be held")
        return self._written({joint.name: joint.rest for joint in self.joints} | dict(held))

    def _written(self, positions: Mapping[str, float]) -> FloatArray:
        q = np.asarray(pinocchio.neutral(self.model))
        for name, value in positions.items():
            position = float(value)
            if not math.isfinite(position):
                raise RobotModelError(f"position of joint '{name}' is {position}")
            self._write(q, self.indices[name], position)
        for index, (leader, factor, offset) in self._followers.items():
            name = str(self.model.names[leader])
            if name in positions:
                self._write(q, index, factor * float(positions[name]) + offset)
        return q

    def _write(self, q: FloatArray, index: int, position: float) -> None:
        joint = self.model.joints[index]
        if joint.nq == 2:
            q[joint.idx_q : joint.idx_q + 2] = math.cos(position), math.sin(position)
        else:
            q[joint.idx_q] = position


JointRow = tuple[int, float, float, bool, FloatArray]
"""Of a joint, its frame turned so that its axis is z: column of the positions q, scale and offset,
whether it slides, and placement, shape (3, 4); see `ChainArrays`."""


def chain_between(
    mechanism: Mechanism,
    base: int,
    camera: int,
    joints: Sequence[str],
    held: Mapping[str, float],
) -> KinematicChain:
    """Build the chain from one frame of a model to another.

    Args:
        mechanism: the robot's joints.
        base: index of the frame in which the camera is placed.
        camera: index of the camera's frame.
        joints: names of those that move; all between the two frames where empty.
        held: where the others stand [rad or m]; where not given, at zero or at their limit
            nearest to it.

    Raises:
        RobotModelError: a joint of `joints` is not between the two frames, or a position of
            `held` is not finite or is that of an unknown joint.
    """
    model = mechanism.model
    signed_joints = list(_signed_joints(model, base, camera))
    between = list(dict.fromkeys(mechanism.owner_of(index) for index, _ in signed_joints))
    moving = [index for index in between if not joints or str(model.names[index]) in joints]
    names = tuple(str(model.names[index]) for index in moving)
    for name in joints:
        if name not in names:
            raise RobotModelError(
                f"joint '{name}' does not move the camera against the base; these do: "
                + (", ".join(str(model.names[index]) for index in between) or "none")
            )
    rows, tail = _rows(mechanism, (base, camera), signed_joints, moving, held)
    limits = [mechanism.limits_of(index) for index in moving]
    return KinematicChain(
        joint_names=names,
        lower=np.array([joint.lower for joint in limits]),
        upper=np.array([joint.upper for joint in limits]),
        velocity=np.array([joint.velocity for joint in limits]),
        is_continuous=np.array([joint.is_continuous for joint in limits], dtype=bool),
        is_prismatic=np.array([mechanism.slides(index) for index in moving], dtype=bool),
        arrays=ChainArrays(*joint_arrays(rows), np.ascontiguousarray(tail[:3])),
    )


def _signed_joints(model: pinocchio.Model, base: int, camera: int) -> Iterator[tuple[int, int]]:
    """Joints from the base to the camera: (index, 1), or (index, -1) from the far end."""
    up, down = (
        [int(index) for index in model.supports[model.frames[frame].parentJoint]]
        for frame in (base, camera)
    )
    shared = sum(1 for first, second in zip(up, down, strict=False) if first == second)
    yield from ((index, -1) for index in reversed(up[shared:]))
    yield from ((index, 1) for index in down[shared:])


def _rows(
    mechanism: Mechanism,
    ends: tuple[int, int],
    signed_joints: list[tuple[int, int]],
    moving: list[int],
    held: Mapping[str, float],
) -> tuple[list[JointRow], FloatArray]:
    """The joints that move, and the camera in the frame of the last one."""
    model = mechanism.model
    data = model.createData()
    pinocchio.forwardKinematics(model, data, mechanism.resting(held))
    rows: list[JointRow] = []
    before, last = (homogeneous(model.frames[frame].placement) for frame in ends)
    before = invert_transform(before)
    for index, sign in signed_joints:
        if mechanism.owner_of(index) not in moving or mechanism.scaling_of(index)[0] == 0.0:
            pose = homogeneous(data.liMi[index])
            before = before @ (pose if sign > 0 else invert_transform(pose))
            continue
        placement = homogeneous(model.jointPlacements[index])
        step, turn = joint_step(mechanism, data, index, sign, moving)
        T_before_joint = before @ placement if sign > 0 else before
        rows.append((*step, (T_before_joint @ turn)[:3]))
        before = turn.T if sign > 0 else turn.T @ invert_transform(placement)
    return rows, before @ last


def joint_step(
    mechanism: Mechanism, data: pinocchio.Data, index: int, sign: int, moving: list[int]
) -> tuple[tuple[int, float, float, bool], FloatArray]:
    """A `JointRow` but for its placement, and the turn, (4, 4), that takes z to the axis."""
    scaling, offset = mechanism.scaling_of(index)
    motion = np.asarray(data.joints[index].S, dtype=np.float64).reshape(6)
    prismatic = bool(np.linalg.norm(motion[:3]) > 0.5)
    turn = make_transform(_turn_of_z(motion[:3] if prismatic else motion[3:]), np.zeros(3))
    column = moving.index(mechanism.owner_of(index))
    return (column, sign * scaling, sign * offset, prismatic), turn


def _turn_of_z(axis: FloatArray) -> FloatArray:
    """A rotation, shape (3, 3), whose third column is the unit vector `axis`."""
    aside = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def joint_arrays(
    rows: Sequence[JointRow],
) -> tuple[
    NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], FloatArray
]:
    """Columns, scales, offsets, whether they slide, shape (S,), and placements, (S, 3, 4)."""
    columns, scales, offsets, slide, places = zip(*rows, strict=True) if rows else ((),) * 5
    return (
        np.array(columns, dtype=np.int64),
        np.array(scales, dtype=np.float64),
        np.array(offsets, dtype=np.float64),
        np.array(slide, dtype=bool),
        np.array(places, dtype=np.float64).reshape(-1, 3, 4),
    )


def homogeneous(placement: pinocchio.SE3) -> FloatArray:
    """A pose of Pinocchio's as a transform, shape (4, 4)."""
    return np.array(placement.homogeneous)
