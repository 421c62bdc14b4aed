"""All links that an arm moves, not only those between base and camera, as plain arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio
from numpy.typing import NDArray

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.chain_builder import homogeneous, joint_step
from infomap_ros.motion.robot.robot_model import RobotModel


class TreeArrays(NamedTuple):
    """A tree of bodies; body 0 is the base, body b > 0 is moved by joint b - 1.

    As in `chain_kernels.ChainArrays`, joint k moves about or along the z axis of its own frame by
    ``scales[k] * q[columns[k]] + offsets[k]``.

    Attributes:
        parents: body that carries joint k, at most k, shape (B,).
        columns: index into the positions q, shape (B,).
        scales: shape (B,).
        offsets: [rad or m], shape (B,).
        prismatic: slides instead of turning, shape (B,).
        placements: of joint k at zero in the body that carries it, shape (B, 3, 4).
    """

    parents: NDArray[np.int64]
    columns: NDArray[np.int64]
    scales: NDArray[np.float64]
    offsets: NDArray[np.float64]
    prismatic: NDArray[np.bool_]
    placements: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinkTree:
    """The bodies that the arm's joints move against each other.

    Attributes:
        arrays: for kernels.
        bodies: body of each joint of the Pinocchio model, shape (njoints,).
        placements: of each of these joints' frames in its body, shape (njoints, 4, 4).
    """

    arrays: TreeArrays
    bodies: NDArray[np.int64]
    placements: FloatArray

    def bodies_up_from(self, body: int) -> Iterator[int]:
        """The body, the one that carries it, and so on; without the base."""
        while body > 0:
            yield body
            body = int(self.arrays.parents[body - 1])

    def axis(self, joint: int) -> FloatArray:
        """Axis of a joint in the base frame, all joints at zero, shape (3,)."""
        rotation = np.eye(3)
        for body in self.bodies_up_from(joint + 1):
            rotation = self.arrays.placements[body - 1][:, :3] @ rotation
        return rotation[:, 2]

    @classmethod
    def of(cls, robot: RobotModel, joint_positions: Mapping[str, float] | None = None) -> LinkTree:
        """The tree that the joints of ``robot.arm`` move.

        Args:
            robot: with a camera frame.
            joint_positions: of joints that are not of the arm [rad or m]; where not given, they
                stand at zero or at their limit nearest to it. Unknown names are ignored.

        Raises:
            RobotModelError: the robot has no camera frame, the arm moves its own base frame, or a
                position is not finite.
        """
        model, mechanism, arm = robot.model, robot.mechanism, robot.arm
        names = {joint.name for joint in robot.joints}
        held = {k: float(v) for k, v in (joint_positions or {}).items() if k in names}
        data = model.createData()
        pinocchio.forwardKinematics(model, data, mechanism.resting(held))
        moving = [int(model.getJointId(name)) for name in arm.joint_names]
        bodies = np.zeros(model.njoints, dtype=np.int64)
        poses = np.tile(np.eye(4), (model.njoints, 1, 1))
        poses[0] = _root_in_base(robot, data, moving)
        rows = []
        for index in range(1, model.njoints):
            parent = int(model.parents[index])
            if mechanism.owner_of(index) not in moving or mechanism.scaling_of(index)[0] == 0.0:
                bodies[index] = bodies[parent]
                poses[index] = poses[parent] @ homogeneous(data.liMi[index])
                continue
            (owner, scale, offset, slides), turn = joint_step(mechanism, data, index, 1)
            place = poses[parent] @ homogeneous(model.jointPlacements[index]) @ turn
            rows.append((bodies[parent], moving.index(owner), scale, offset, slides, place[:3]))
            bodies[index], poses[index] = len(rows), turn.T
        return cls(_arrays(rows), bodies, poses)


def _root_in_base(robot: RobotModel, data: pinocchio.Data, moving: list[int]) -> FloatArray:
    model = robot.model
    frame = model.frames[model.getFrameId(robot.base_frame, pinocchio.FrameType.BODY)]
    above = robot.mechanism.above([frame.parentJoint])
    if {robot.mechanism.owner_of(index) for index in above} & set(moving):
        raise RobotModelError(f"the arm's joints move its own base frame '{robot.base_frame}'")
    return invert_transform(homogeneous(data.oMi[frame.parentJoint] * frame.placement))


def _arrays(rows: list[tuple[int, int, float, float, bool, FloatArray]]) -> TreeArrays:
    parents, columns, scales, offsets, prismatic, places = zip(*rows, strict=True) if rows else (
        (), (), (), (), (), (),
    )  # fmt: skip
    return TreeArrays(
        np.array(parents, dtype=np.int64),
        np.array(columns, dtype=np.int64),
        np.array(scales, dtype=np.float64),
        np.array(offsets, dtype=np.float64),
        np.array(prismatic, dtype=bool),
        np.array(places, dtype=np.float64).reshape(-1, 3, 4),
    )
