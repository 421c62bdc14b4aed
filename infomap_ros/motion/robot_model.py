"""The robot as its URDF describes it: joints, frames, forward kinematics, body solids."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import PlacedSolid, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.body_shapes import BodyShape, body_shapes
from infomap_ros.motion.chain import KinematicChain
from infomap_ros.motion.chain_builder import chain_between
from infomap_ros.motion.joint_limits import JointLimits, joint_limits
from infomap_ros.motion.urdf import read_urdf


class RobotModel:
    """A robot: a tree of links. Immutable, and safe to use from several threads.

    Joint positions come as a mapping from joint name to [rad or m], as in
    ``sensor_msgs/JointState``. Names that the robot does not have are ignored, as a robot's joint
    states often hold more than its URDF; a joint that the answer depends on must be there. Joints
    that mimic another follow it and need no position.

    Attributes:
        name: of the robot.
        base_frame: frame in which `forward_kinematics` answers.
        camera_frame: optical frame of the camera, empty if none was given.
        joints: the joints that have a position, in the model's order.
        arm_joints: joints that `arm` moves, empty for all between base and camera.
        model: the Pinocchio model, not to be written to.
    """

    def __init__(
        self,
        model: pinocchio.Model,
        shapes: Sequence[BodyShape] = (),
        base_frame: str = "",
        camera_frame: str = "",
        arm_joints: Sequence[str] = (),
    ) -> None:
        self.model = model
        self.name = str(model.name)
        self._shapes = tuple(shapes)
        self._frame_ids = {
            str(frame.name): index
            for index, frame in enumerate(model.frames)
            if frame.type == pinocchio.FrameType.BODY
        }
        self.base_frame = base_frame or str(model.frames[1].name)
        self.camera_frame = camera_frame
        for frame in filter(None, (self.base_frame, camera_frame)):
            self._frame_id(frame)
        self._joint_ids = {
            str(name): index for index, name in enumerate(model.names) if model.joints[index].nq > 0
        }
        self._joint_ids.pop("universe", None)
        self.joints = tuple(joint_limits(model, index) for index in self._joint_ids.values())
        body = {self._base_joint} | {shape.joint for shape in self._shapes}
        self._needed_by_body = self._joints_above(body)
        self.arm_joints = tuple(arm_joints)
        if self.arm_joints:
            self.chain(self.arm_joints)

    @classmethod
    def from_urdf(
        cls,
        path_or_xml: str | Path,
        camera_frame: str = "",
        base_frame: str = "",
        package_folders: Sequence[str | Path] = (),
        arm_joints: Sequence[str] = (),
    ) -> RobotModel:
        """Read a robot from its URDF.

        Args:
            path_or_xml: path of a file, or the XML itself (``robot_description``).
            camera_frame: optical frame of the camera, a link's name.
            base_frame: link whose frame is the base; the root link where empty.
            package_folders: where ``package://name/...`` and relative mesh files are looked for,
                besides the URDF's own folder, ROS_PACKAGE_PATH and AMENT_PREFIX_PATH.
            arm_joints: joints that `arm` moves; all between base and camera where empty.

        Raises:
            RobotModelError: the URDF is missing or malformed, holds a joint or collision shape of
                an unknown type, a mesh is not found, a frame is unknown, or a joint of the arm does
                not move the camera; names the culprit.
        """
        description = read_urdf(path_or_xml)
        try:
            model = pinocchio.buildModelFromXML(description.xml, True)
        except (ValueError, RuntimeError) as error:
            raise RobotModelError(f"malformed URDF: {error}") from error
        shapes = body_shapes(model, description, package_folders)
        return cls(model, shapes, base_frame, camera_frame, arm_joints)

    @cached_property
    def arm(self) -> KinematicChain:
        """The chain of `arm_joints` from the base to the camera, the joints between them held.

        Raises:
            RobotModelError: the robot has no camera frame.
        """
        return self.chain(self.arm_joints)

    def chain(
        self, joints: Sequence[str] = (), held: Mapping[str, float] | None = None
    ) -> KinematicChain:
        """A chain of joints from the base to the camera.

        Args:
            joints: names of those that move; all between base and camera where empty.
            held: where the others stand [rad or m]; where not given, at zero or at their limit
                nearest to it. Joints that are not on the way do not matter.

        Raises:
            RobotModelError: the robot has no camera frame, a joint of `joints` does not move the
                camera, or a position of `held` is not finite or is that of an unknown joint.
        """
        if not self.camera_frame:
            raise RobotModelError(f"robot '{self.name}' was given no camera frame")
        ends = self._frame_id(self.base_frame), self._frame_id(self.camera_frame)
        return chain_between(self.model, *ends, joints, held)

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all links."""
        return tuple(self._frame_ids)

    @property
    def shapes(self) -> tuple[BodyShape, ...]:
        """Collision shapes of all links, each in the frame of the joint that moves it."""
        return self._shapes

    @property
    def links_with_solids(self) -> tuple[str, ...]:
        """Names of the links that have collision shapes, in the order of `solids_in`."""
        return tuple(dict.fromkeys(shape.link for shape in self._shapes))

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
            + (", ".join(self._joint_ids) or "none")
        )

    def configuration(
        self, joint_positions: Mapping[str, float], frames: Iterable[str] | None = None
    ) -> FloatArray:
        """Pinocchio's configuration vector, shape (nq,).

        Args:
            joint_positions: by joint name [rad or m].
            frames: links whose place must be known; joints that move none of them may be missing
                and are set to zero. Without it all joints must be there.

        Raises:
            RobotModelError: a joint is missing or its position is not finite, or a frame is
                unknown; names it.
        """
        if frames is None:
            return self._configuration(joint_positions, self._joint_ids)
        joints = {self._parent_joint(self._frame_id(frame)) for frame in frames}
        return self._configuration(joint_positions, self._joints_above(joints))

    def forward_kinematics(self, joint_positions: Mapping[str, float], frame: str) -> FloatArray:
        """Place of a frame: ``T_base_frame``, shape (4, 4).

        Args:
            joint_positions: by joint name [rad or m]; only the joints between the base and the
                frame must be there.
            frame: name of a link.

        Raises:
            RobotModelError: the frame is unknown, or a joint is missing or not finite.
        """
        q = self.configuration(joint_positions, (self.base_frame, frame))
        data = self._placed(q)
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
        frame_joint = self._parent_joint(self._frame_id(frame))
        needed = self._needed_by_body | self._joints_above({frame_joint})
        data = self._placed(self._configuration(joint_positions, needed))
        T_frame_root = invert_transform(self._root_frame(data, frame))
        T_frame_joint = [T_frame_root @ pose.homogeneous for pose in data.oMi]
        return [
            PlacedSolid(shape.solid, T_frame_joint[shape.joint] @ shape.placement, shape.link)
            for shape in self._shapes
        ]

    @property
    def _base_joint(self) -> int:
        return self._parent_joint(self._frame_id(self.base_frame))

    def _frame_id(self, frame: str) -> int:
        try:
            return self._frame_ids[frame]
        except KeyError:
            raise RobotModelError(f"robot '{self.name}' has no frame '{frame}'") from None

    def _parent_joint(self, frame_id: int) -> int:
        return int(self.model.frames[frame_id].parentJoint)

    def _joints_above(self, joints: Iterable[int]) -> frozenset[str]:
        """Names of the joints with a position of their own that move any of these joints."""
        model = self.model
        above = {int(index) for joint in joints for index in model.supports[joint]}
        leaders = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
        above |= {int(leaders[index]) for index in above if index in leaders}
        return frozenset(name for name, index in self._joint_ids.items() if index in above)

    def _configuration(
        self, joint_positions: Mapping[str, float], needed: Iterable[str]
    ) -> FloatArray:
        missing = [name for name in needed if name not in joint_positions]
        if missing:
            raise RobotModelError(f"no position of joint {', '.join(map(repr, sorted(missing)))}")
        q = np.asarray(pinocchio.neutral(self.model))
        for name in needed:
            position = float(joint_positions[name])
            if not math.isfinite(position):
                raise RobotModelError(f"position of joint '{name}' is {position}")
            joint = self.model.joints[self._joint_ids[name]]
            if joint.nq == 2:
                q[joint.idx_q : joint.idx_q + 2] = math.cos(position), math.sin(position)
            else:
                q[joint.idx_q] = position
        return q

    def _placed(self, q: FloatArray) -> pinocchio.Data:
        """Kinematics at `q` in data of this call alone, so that threads do not meet."""
        data = self.model.createData()
        pinocchio.forwardKinematics(self.model, data, q)
        return data

    def _root_frame(self, data: pinocchio.Data, frame: str) -> FloatArray:
        item = self.model.frames[self._frame_id(frame)]
        return np.asarray((data.oMi[item.parentJoint] * item.placement).homogeneous)
