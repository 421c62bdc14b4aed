"""Finding the chain of joints between two frames of a robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.robot.chain_kernels import ChainArrays
from infomap_ros.motion.robot.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class _Step:
    """A joint that moves, with its frame turned so that its axis is z; see `ChainArrays`."""

    owner: int
    scale: float
    offset: float
    prismatic: bool
    placement: FloatArray


def chain_between(
    mechanism: Mechanism,
    base: int,
    camera: int,
    joints: Sequence[str] = (),
    held: Mapping[str, float] | None = None,
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
    way = list(_way(model, base, camera))
    between = list(dict.fromkeys(mechanism.owner_of(index) for index, _ in way))
    moving = [index for index in between if not joints or str(model.names[index]) in joints]
    names = tuple(str(model.names[index]) for index in moving)
    for name in joints:
        if name not in names:
            raise RobotModelError(
                f"joint '{name}' does not move the camera against the base; these do: "
                + (", ".join(str(model.names[index]) for index in between) or "none")
            )
    steps, tail = _steps(mechanism, (base, camera), way, moving, held or {})
    limits = [mechanism.limits_of(index) for index in moving]
    return KinematicChain(
        joint_names=names,
        lower=np.array([joint.lower for joint in limits]),
        upper=np.array([joint.upper for joint in limits]),
        velocity=np.array([joint.velocity for joint in limits]),
        is_continuous=np.array([joint.is_continuous for joint in limits], dtype=bool),
        is_prismatic=np.array([mechanism.slides(index) for index in moving], dtype=bool),
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


def _steps(
    mechanism: Mechanism,
    ends: tuple[int, int],
    way: list[tuple[int, int]],
    moving: list[int],
    held: Mapping[str, float],
) -> tuple[list[_Step], FloatArray]:
    """The joints that move, and the camera in the frame of the last one."""
    model = mechanism.model
    data = model.createData()
    pinocchio.forwardKinematics(model, data, mechanism.resting(held))
    steps: list[_Step] = []
    before, last = (homogeneous(model.frames[frame].placement) for frame in ends)
    before = invert_transform(before)
    for index, sign in way:
        if mechanism.owner_of(index) not in moving or mechanism.scaling_of(index)[0] == 0.0:
            pose = homogeneous(data.liMi[index])
            before = before @ (pose if sign > 0 else invert_transform(pose))
            continue
        placement = homogeneous(model.jointPlacements[index])
        step, turn = joint_step(mechanism, data, index, sign)
        T_before_joint = before @ placement if sign > 0 else before
        steps.append(_Step(*step, T_before_joint @ turn))
        before = turn.T if sign > 0 else turn.T @ invert_transform(placement)
    return steps, before @ last


def joint_step(
    mechanism: Mechanism, data: pinocchio.Data, index: int, sign: int
) -> tuple[tuple[int, float, float, bool], FloatArray]:
    """What a `_Step` holds but its placement, and the turn, (4, 4), that takes z to the axis."""
    scaling, offset = mechanism.scaling_of(index)
    motion = np.asarray(data.joints[index].S, dtype=np.float64).reshape(6)
    prismatic = bool(np.linalg.norm(motion[:3]) > 0.5)
    turn = make_transform(_turn_of_z(motion[:3] if prismatic else motion[3:]), np.zeros(3))
    return (mechanism.owner_of(index), sign * scaling, sign * offset, prismatic), turn


def _turn_of_z(axis: FloatArray) -> FloatArray:
    """A rotation, shape (3, 3), whose third column is the unit vector `axis`."""
    aside = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


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
