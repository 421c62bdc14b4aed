"""The robot as its URDF describes it: joints, frames, forward kinematics, body solids.

And all links that its arm moves, not only those between base and camera, as plain arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio
from numpy.typing import NDArray

from infomap_ros.errors import ConfigError, RobotModelError
from infomap_ros.geometry import PlacedSolid, invert_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.body_shapes import BodyShape, body_shapes, visible_shapes
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.robot.mechanism import (
    JointLimits,
    JointRow,
    Mechanism,
    chain_between,
    homogeneous,
    joint_arrays,
    joint_step,
)
from infomap_ros.motion.robot.urdf import read_urdf


class RobotModel:
    """A robot: a tree of links. Immutable, and safe to use from several threads.

    Joint positions come as a mapping from joint name to [rad or m], as in
    ``sensor_msgs/JointState``. Names that the robot does not have are ignored, as a robot's joint
    states often hold more than its URDF; a joint that the answer depends on must be there. Joints
    that mimic another follow it and need no position, nor do joints without a range.

    Attributes:
        name: of the robot.
        base_frame: frame in which `forward_kinematics` answers.
        camera_frame: optical frame of the camera, empty if none was given.
        joints: the joints that have a position, in the model's order.
        arm_joints: joints that `arm` moves, empty for all between base and camera.
        mechanism: the joints, with those that mimic.
        model: the Pinocchio model, not to be written to.
        shapes: collision shapes of all links, each in the frame of the joint that moves it.
        missing: collision meshes that this computer does not have, in sentences: who plans motions
            needs them.
        empty: collision shapes without a size, in sentences.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        shapes: Sequence[BodyShape] = (),
        base_frame: str = "",
        camera_frame: str = "",
        arm_joints: Sequence[str] = (),
        held: Mapping[str, float] | None = None,
        visible: Callable[[], Sequence[BodyShape]] = tuple,
        missing: Sequence[str] = (),
        empty: Sequence[str] = (),
    ) -> None:
        self.mechanism = mechanism
        self.model = model = mechanism.model
        self.name = str(model.name)
        self.shapes = tuple(shapes)
        self.missing, self.empty = tuple(missing), tuple(empty)
        self._frame_ids = {
            str(frame.name): index
            for index, frame in enumerate(model.frames)
            if frame.type == pinocchio.FrameType.BODY
        }
        self.base_frame = base_frame or str(model.frames[1].name)
        self.camera_frame = camera_frame
        for frame in filter(None, (self.base_frame, camera_frame)):
            self._frame_id(frame)
        self.joints = mechanism.joints
        body = {self._parent_joint(self.base_frame), *(shape.joint for shape in self.shapes)}
        self._needed_by_body = mechanism.owners(mechanism.above(body))
        self.arm_joints = tuple(arm_joints)
        self._held = dict(held or {})
        self._find_visible = visible
        if self.arm_joints:
            _ = self.arm  # so that what is wrong with it is said at once

    @classmethod
    def from_urdf(
        cls,
        path_or_xml: str | Path,
        camera_frame: str = "",
        base_frame: str = "",
        package_folders: Sequence[str | Path] = (),
        arm_joints: Sequence[str] = (),
        mimics: Mapping[str, str] | None = None,
        assumed_joints: Sequence[str] = (),
    ) -> RobotModel:
        """Read a robot from its URDF.

        Args:
            path_or_xml: path of a file, or the XML itself (``robot_description``).
            camera_frame: optical frame of the camera, a link's name.
            base_frame: link whose frame is the base; the root link where empty.
            package_folders: where ``package://name/...`` and relative mesh files are looked for,
                besides the URDF's own folder, ROS_PACKAGE_PATH and AMENT_PREFIX_PATH.
            arm_joints: joints that `arm` moves; all between base and camera where empty.
            mimics: joints that follow another although the URDF does not say so, name -> leader,
                as the segments of a telescope that one motor drives.
            assumed_joints: joints whose position nobody reports, as often of wheels; where it is
                missing they stand at zero or at their limit nearest to it.

        Raises:
            RobotModelError: the URDF is missing or malformed, holds a joint or collision shape of
                an unknown type, a frame or joint is unknown, or a joint of the arm does not move
                the camera; names the culprit.
        """
        description = read_urdf(path_or_xml, mimics)
        try:
            model = pinocchio.buildModelFromXML(description.xml)
        except (ValueError, RuntimeError) as error:
            raise RobotModelError(f"malformed URDF: {error}") from error
        shapes, missing, empty = body_shapes(model, description, package_folders)
        mechanism = Mechanism(model, description.followers, assumed_joints)

        @cache
        def visible() -> Sequence[BodyShape]:
            return visible_shapes(model, description, package_folders, shapes)

        return cls(
            mechanism, shapes, base_frame, camera_frame, arm_joints, None, visible, missing, empty
        )

    @cached_property
    def arm(self) -> KinematicChain:
        """The chain of `arm_joints` from the base to the camera, the joints between them held.

        Raises:
            RobotModelError: the robot has no camera frame, a joint of `arm_joints` does not move
                the camera, or a position at which one is held is not finite or of an unknown joint.
        """
        if not self.camera_frame:
            raise RobotModelError(f"robot '{self.name}' was given no camera frame")
        ends = self._frame_id(self.base_frame), self._frame_id(self.camera_frame)
        return chain_between(self.mechanism, *ends, self.arm_joints, self._held)

    def holding(self, joint_positions: Mapping[str, float]) -> RobotModel:
        """The same robot, `arm` of which holds the joints that it does not move at these positions.

        Args:
            joint_positions: by name [rad or m]; those of the arm and unknown ones are ignored.

        Raises:
            RobotModelError: a position is not finite.
        """
        if not self.arm_joints:
            return self
        others = set(self.mechanism.indices) - set(self.arm_joints)
        held = {name: joint_positions[name] for name in others if name in joint_positions}
        return RobotModel(
            self.mechanism, self.shapes, self.base_frame, self.camera_frame, self.arm_joints, held,
            self._find_visible, self.missing, self.empty,
        )  # fmt: skip

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all links."""
        return tuple(self._frame_ids)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Collision shapes that could not be had, and why, in sentences."""
        return self.missing + self.empty

    @property
    def links_with_solids(self) -> tuple[str, ...]:
        """Names of the links that have collision shapes, in the order of `solids_in`."""
        return tuple(dict.fromkeys(shape.link for shape in self.shapes))

    def joint(self, name: str) -> JointLimits:
        """The joint of that name.

        Raises:
            RobotModelError: the robot has no such joint.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise RobotModelError(
            f"robot '{self.name}' has no joint '{name}'; it has "
            + (", ".join(self.mechanism.indices) or "none")
        )

    def joints_above(self, links: Iterable[str]) -> frozenset[str]:
        """Names of the joints that move any of these links.

        Raises:
            RobotModelError: a link is unknown.
        """
        mechanism = self.mechanism
        return mechanism.owners(mechanism.above(map(self._parent_joint, links)))

    def forward_kinematics(self, joint_positions: Mapping[str, float], frame: str) -> FloatArray:
        """Place of a frame: ``T_base_frame``, shape (4, 4).

        Args:
            joint_positions: by joint name [rad or m]; only the joints between the base and the
                frame must be there.
            frame: name of a link.

        Raises:
            RobotModelError: the frame is unknown, or a joint is missing or not finite.
        """
        mechanism = self.mechanism
        ends = (mechanism.above([self._parent_joint(f)]) for f in (self.base_frame, frame))
        between = mechanism.owners(next(ends) ^ next(ends))
        data = self._placed(mechanism.configuration(joint_positions, between))
        return invert_transform(self._root_frame(data, self.base_frame)) @ self._root_frame(
            data, frame
        )

    def solids_in(self, frame: str, joint_positions: Mapping[str, float]) -> list[PlacedSolid]:
        """Collision solids of all links, placed in a frame.

        Args:
            frame: name of a link, for example the camera's optical frame.
            joint_positions: by joint name [rad or m]; all joints that move a solid must be there.

        Returns:
            Solids with ``T_frame_solid``, named by their links.

        Raises:
            RobotModelError: the frame is unknown, or a joint is missing or not finite.
        """
        mechanism = self.mechanism
        needed = mechanism.owners(mechanism.above([self._parent_joint(frame)]))
        q = mechanism.configuration(joint_positions, self._needed_by_body | needed)
        return self._placed_shapes(self.shapes, frame, q)

    def visible_solids_in(
        self, frame: str, joint_positions: Mapping[str, float]
    ) -> list[PlacedSolid]:
        """What a camera may see of the robot, placed in a frame.

        The solids of `solids_in`, and what of the description's visual shapes sticks out of them.
        The first call reads their meshes.

        Args:
            frame: as for `solids_in`.
            joint_positions: as for `solids_in`; joints that move visual shapes alone, such as the
                swivel of a caster, are at rest where they are missing.

        Raises:
            RobotModelError: as `solids_in`.
        """
        solids, beyond = self.solids_in(frame, joint_positions), self._find_visible()
        if not beyond:
            return solids
        everything = {joint.name: joint.rest for joint in self.joints} | dict(joint_positions)
        q = self.mechanism.configuration(everything, self.mechanism.indices)
        return solids + self._placed_shapes(beyond, frame, q)

    def _placed_shapes(
        self, shapes: Iterable[BodyShape], frame: str, q: FloatArray
    ) -> list[PlacedSolid]:
        data = self._placed(q)
        T_frame_root = invert_transform(self._root_frame(data, frame))
        T_frame_joint = [T_frame_root @ pose.homogeneous for pose in data.oMi]
        return [
            PlacedSolid(shape.solid, T_frame_joint[shape.joint] @ shape.placement, shape.link)
            for shape in shapes
        ]

    def _frame_id(self, frame: str) -> int:
        try:
            return self._frame_ids[frame]
        except KeyError:
            raise RobotModelError(f"robot '{self.name}' has no frame '{frame}'") from None

    def _parent_joint(self, frame: str) -> int:
        return int(self.model.frames[self._frame_id(frame)].parentJoint)

    def _placed(self, q: FloatArray) -> pinocchio.Data:
        """Kinematics at `q` in data of this call alone, so that threads do not meet."""
        data = self.model.createData()
        pinocchio.forwardKinematics(self.model, data, q)
        return data

    def _root_frame(self, data: pinocchio.Data, frame: str) -> FloatArray:
        item = self.model.frames[self._frame_id(frame)]
        return np.asarray((data.oMi[item.parentJoint] * item.placement).homogeneous)


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


class TreeArrays(NamedTuple):
    """A tree of bodies; body 0 is the base, body b > 0 is moved by joint b - 1.

    As in `chain.ChainArrays`, joint k moves about or along the z axis of its own frame by
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
        parents, rows = list[int](), list[JointRow]()
        for index in range(1, model.njoints):
            parent = int(model.parents[index])
            if mechanism.owner_of(index) not in moving or mechanism.scaling_of(index)[0] == 0.0:
                bodies[index] = bodies[parent]
                poses[index] = poses[parent] @ homogeneous(data.liMi[index])
                continue
            step, turn = joint_step(mechanism, data, index, 1, moving)
            place = poses[parent] @ homogeneous(model.jointPlacements[index]) @ turn
            parents.append(int(bodies[parent]))
            rows.append((*step, place[:3]))
            bodies[index], poses[index] = len(rows), turn.T
        carried_by = np.array(parents, dtype=np.int64)
        return cls(TreeArrays(carried_by, *joint_arrays(rows)), bodies, poses)


def _root_in_base(robot: RobotModel, data: pinocchio.Data, moving: list[int]) -> FloatArray:
    model = robot.model
    frame = model.frames[model.getFrameId(robot.base_frame, pinocchio.FrameType.BODY)]
    above = robot.mechanism.above([frame.parentJoint])
    if {robot.mechanism.owner_of(index) for index in above} & set(moving):
        raise RobotModelError(f"the arm's joints move its own base frame '{robot.base_frame}'")
    return invert_transform(homogeneous(data.oMi[frame.parentJoint] * frame.placement))
