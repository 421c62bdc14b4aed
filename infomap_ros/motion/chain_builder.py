"""Finding the chain of joints between two frames of a robot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.chain import KinematicChain
from infomap_ros.motion.chain_kernels import ChainArrays
from infomap_ros.motion.joint_limits import joint_limits


@dataclass(frozen=True, eq=False)
class _Step:
    """A joint that moves, with its frame turned so that its axis is z; see `ChainArrays`."""

    owner: int
    scale: float
    offset: float
    prismatic: bool
    placement: FloatArray


def chain_between(
    model: pinocchio.Model,
    base: int,
    camera: int,
    joints: Sequence[str] = (),
    held: Mapping[str, float] | None = None,
) -> KinematicChain:
    """Build the chain from one frame of a model to another.

    Args:
        model: the robot; every joint has one degree of freedom.
        base: index of the frame in which the camera is placed.
        camera: index of the camera's frame.
        joints: names of those that move; all between the two frames where empty.
        held: where the others stand [rad or m]; where not given, at zero or at their limit
            nearest to it.

    Raises:
        RobotModelError: a joint of `joints` is not between the two frames, or a position of
            `held` is not finite or is that of an unknown joint.
    """
    way = list(_way(model, base, camera))
    between = list(dict.fromkeys(owner_of(model, index) for index, _ in way))
    moving = [index for index in between if not joints or str(model.names[index]) in joints]
    names = tuple(str(model.names[index]) for index in moving)
    for name in joints:
        if name not in names:
            raise RobotModelError(
                f"joint '{name}' does not move the camera against the base; these do: "
                + (", ".join(str(model.names[index]) for index in between) or "none")
            )
    steps, tail = _steps(model, base, camera, way, moving, held or {})
    limits = [joint_limits(model, index) for index in moving]
    return KinematicChain(
        joint_names=names,
        lower=np.array([joint.lower for joint in limits]),
        upper=np.array([joint.upper for joint in limits]),
        velocity=np.array([joint.velocity for joint in limits]),
        is_continuous=np.array([joint.is_continuous for joint in limits], dtype=bool),
        is_prismatic=np.array([_slides(model, index) for index in moving], dtype=bool),
        arrays=_arrays(steps, moving, tail),
    )


def _way(model: pinocchio.Model, base: int, camera: int) -> Iterator[tuple[int, int]]:
    """Joints from the base to the camera: (index, 1), or (index, -1) from the far end."""
    up, down = (
        [int(index) for index in model.supports[model.frames[frame].parentJoint]]
        for frame in (base, camera)
    )
    shared = sum(1 for first, second in zip(up, down, strict=False) if first == second)
    yield from ((index, -1) for index in reversed(up[shared:]))
    yield from ((index, 1) for index in down[shared:])


def owner_of(model: pinocchio.Model, index: int) -> int:
    """The joint whose position moves this one: itself, or the one that it mimics."""
    leaders = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
    return int(leaders.get(index, index))


def _slides(model: pinocchio.Model, index: int) -> bool:
    return str(model.joints[index].shortname()).startswith("JointModelP")


def _steps(
    model: pinocchio.Model,
    base: int,
    camera: int,
    way: list[tuple[int, int]],
    moving: list[int],
    held: Mapping[str, float],
) -> tuple[list[_Step], FloatArray]:
    """The joints that move, and the camera in the frame of the last one."""
    data = model.createData()
    pinocchio.forwardKinematics(model, data, held_configuration(model, held))
    steps: list[_Step] = []
    before = invert_transform(homogeneous(model.frames[base].placement))
    for index, sign in way:
        if owner_of(model, index) not in moving or scaling_of(model, index)[0] == 0.0:
            pose = homogeneous(data.liMi[index])
            before = before @ (pose if sign > 0 else invert_transform(pose))
            continue
        placement = homogeneous(model.jointPlacements[index])
        step, turn = joint_step(model, data, index, sign)
        T_before_joint = before @ placement if sign > 0 else before
        steps.append(_Step(*step, T_before_joint @ turn))
        before = turn.T if sign > 0 else turn.T @ invert_transform(placement)
    return steps, before @ homogeneous(model.frames[camera].placement)


def joint_step(
    model: pinocchio.Model, data: pinocchio.Data, index: int, sign: int
) -> tuple[tuple[int, float, float, bool], FloatArray]:
    """What a `_Step` holds but its placement, and the turn, (4, 4), that takes z to the axis."""
    scaling, offset = scaling_of(model, index)
    motion = np.asarray(data.joints[index].S, dtype=np.float64).reshape(6) / scaling
    prismatic = bool(np.linalg.norm(motion[:3]) > 0.5)
    turn = make_transform(_turn_of_z(motion[:3] if prismatic else motion[3:]), np.zeros(3))
    return (owner_of(model, index), sign * scaling, sign * offset, prismatic), turn


def scaling_of(model: pinocchio.Model, index: int) -> tuple[float, float]:
    """Factor and offset from the position of `owner_of` to that of the joint."""
    if owner_of(model, index) == index:
        return 1.0, 0.0
    mimic = model.joints[index].extract()
    return float(mimic.scaling), float(mimic.offset)


def _turn_of_z(axis: FloatArray) -> FloatArray:
    """A rotation, shape (3, 3), whose third column is the unit vector `axis`."""
    aside = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def held_configuration(model: pinocchio.Model, held: Mapping[str, float]) -> FloatArray:
    """Pinocchio's configuration with joints as for `chain_between`, shape (nq,)."""
    q = np.asarray(pinocchio.neutral(model))
    indices = {str(name): index for index, name in enumerate(model.names) if index > 0}
    for name, position in held.items():
        if name not in indices or model.joints[indices[name]].nq == 0:
            raise RobotModelError(f"joint '{name}' has no position that can be held")
        if not math.isfinite(position):
            raise RobotModelError(f"position of joint '{name}' is {position}")
    for name, index in indices.items():
        joint = model.joints[index]
        if joint.nq == 1:
            limits = joint_limits(model, index)
            nearest = min(max(0.0, limits.lower), limits.upper)
            q[joint.idx_q] = held.get(name, nearest)
        elif joint.nq == 2:
            position = held.get(name, 0.0)
            q[joint.idx_q : joint.idx_q + 2] = math.cos(position), math.sin(position)
    return q


def _arrays(steps: list[_Step], moving: list[int], tail: FloatArray) -> ChainArrays:
    placements = [step.placement[:3] for step in steps]
    return ChainArrays(
        columns=np.array([moving.index(step.owner) for step in steps], dtype=np.int64),
        scales=np.array([step.scale for step in steps], dtype=np.float64),
        offsets=np.array([step.offset for step in steps], dtype=np.float64),
        prismatic=np.array([step.prismatic for step in steps], dtype=bool),
        placements=np.array(placements, dtype=np.float64).reshape(-1, 3, 4),
        tail=np.ascontiguousarray(tail[:3]),
    )


def homogeneous(placement: pinocchio.SE3) -> FloatArray:
    """A pose of Pinocchio's as a transform, shape (4, 4)."""
    return np.array(placement.homogeneous)
