"""Cameras of a robot, the joints that move them, and the ends of its arms.

Which parts of a robot its weight rests on: driven wheels, casters, and what hangs low.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio

from infomap_ros.geometry import invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import solid_extent

_NEAR_GROUND = 0.015  # [m] of the lowest point of what stands on the ground
_LEVEL = 0.95  # least cosine between an axis and the direction that it is taken for
_ROUND = 0.15  # share by which the two extents across the axis of a wheel may differ
_SPRING = 0.15  # largest range of a wheel's suspension [m or rad]
_LARGEST_CASTER = 0.2  # horizontal extent [m]; what is larger hangs low over the ground

Extent = tuple[FloatArray, FloatArray]


class WheelParts(NamedTuple):
    """What a robot stands on; everything in the order of its description.

    Attributes:
        left: joints of the driven wheels on the left.
        right: joints of the driven wheels on the right.
        casters: links that stand on the ground and are driven by nothing.
        hovering: large links whose solids end within 15 mm of the ground, such as a base's skirt.
        ground: height of the lowest point of all solids in the base frame [m].
    """

    left: tuple[str, ...]
    right: tuple[str, ...]
    casters: tuple[str, ...]
    hovering: tuple[str, ...]
    ground: float


def find_wheels(robot: RobotModel) -> WheelParts:
    """Find wheels by geometry, all joints at rest; names do not matter.

    A driven wheel is a round link on the ground that turns without end about the y axis of the
    base, and does not hang from a joint that turns about the vertical, as the wheel of a caster
    does. Left wheels have y > 0. A robot without driven wheels on both sides has none of the rest.

    Args:
        robot: with its base frame; a robot without solids stands on nothing.
    """
    extents = link_extents(robot)
    if not extents:
        return WheelParts((), (), (), (), 0.0)
    ground = min(float(low[2]) for low, _ in extents.values())
    standing = [
        link
        for link, (low, _) in extents.items()
        if low[2] < ground + _NEAR_GROUND and _is_below_arms(robot, link)
    ]
    left: list[str] = []
    right: list[str] = []
    casters: list[str] = []
    hovering: list[str] = []
    for link in standing:
        low, high = extents[link]
        joint = _driven_by(robot, link, high - low)
        if joint:
            (left if low[1] + high[1] > 0.0 else right).append(joint)
        elif float((high - low)[:2].max()) < _LARGEST_CASTER:
            casters.append(link)
        else:
            hovering.append(link)
    if not (left and right):
        return WheelParts((), (), (), (), ground)
    return WheelParts(tuple(left), tuple(right), tuple(casters), tuple(hovering), ground)


def link_extents(robot: RobotModel) -> Mapping[str, Extent]:
    """Lowest and highest coordinates of each link's solids, (3,) each [m, base frame].

    All joints stand at zero, or at their limit nearest to it.
    """
    joints = {joint.name: joint.rest for joint in robot.joints}
    placed = robot.solids_in(robot.base_frame, joints)
    found: dict[str, Extent] = {}
    for shape, solid in zip(robot.shapes, placed, strict=True):
        vertices = shape.vertices
        if vertices is not None:
            points = vertices @ solid.transform[:3, :3].T + solid.transform[:3, 3]
            low, high = points.min(axis=0), points.max(axis=0)
        else:
            low, high = solid_extent(solid)
        before = found.get(shape.link, (low, high))
        found[shape.link] = np.minimum(low, before[0]), np.maximum(high, before[1])
    return found


def joint_axis(robot: RobotModel, index: int) -> FloatArray:
    """Axis of a joint of the Pinocchio model in the base frame, all joints at rest, shape (3,)."""
    model = robot.model
    data = model.createData()
    pinocchio.forwardKinematics(model, data, robot.mechanism.resting({}))
    pinocchio.updateFramePlacements(model, data)
    base = data.oMf[model.getFrameId(robot.base_frame, pinocchio.FrameType.BODY)]
    motion = np.asarray(data.joints[index].S, dtype=np.float64).reshape(6)
    axis = motion[:3] if np.linalg.norm(motion[:3]) > 0.5 else motion[3:]
    return np.asarray(base.rotation.T @ data.oMi[index].rotation @ axis)


def _is_below_arms(robot: RobotModel, link: str) -> bool:
    """Whether only wheels, swivels and springs carry a link."""
    model = robot.model
    endless = {
        joint.name
        for joint in robot.joints
        if joint.is_continuous or joint.upper - joint.lower < _SPRING
    }
    index = int(model.frames[model.getFrameId(link, pinocchio.FrameType.BODY)].parentJoint)
    return all(str(model.names[above]) in endless for above in robot.mechanism.above([index]))


def _driven_by(robot: RobotModel, link: str, size: FloatArray) -> str:
    """The joint that drives a link as a wheel; empty for none."""
    model = robot.model
    index = int(model.frames[model.getFrameId(link, pinocchio.FrameType.BODY)].parentJoint)
    limits = {joint.name: joint for joint in robot.joints}.get(str(model.names[index]))
    if limits is None or not limits.is_continuous:
        return ""
    if abs(joint_axis(robot, index)[1]) < _LEVEL:
        return ""
    if abs(size[0] - size[2]) > _ROUND * max(size[0], size[2]):
        return ""
    above = int(model.parents[index])
    while above > 0:
        if abs(joint_axis(robot, above)[2]) > _LEVEL and not robot.mechanism.slides(above):
            return ""  # the wheel of a caster
        above = int(model.parents[above])
    return limits.name


_OPTICAL = re.compile(r"optical", re.IGNORECASE)
_NO_IMAGES = re.compile(r"accel|gyro|imu|projector", re.IGNORECASE)
_HAND = re.compile(r"hand_|finger|gripper|jaw|knuckle|thumb", re.IGNORECASE)
_TOOL = re.compile(r"tool|tcp|flange", re.IGNORECASE)
_SIDES = (("left", "right"), ("infra1", "infra2"), ("_l_", "_r_"))
_PREFERRED = (r"left", r"rgb|color", r"")  # of frames that are alike
LEAST_BASELINE = 0.04
"""Of cameras that measure a room [m]: 3.4 px disparity at 4 m, with 340 px focal length."""
_PARALLEL = 1e-3  # [rad] or [m] by which the frames of a stereo pair may differ otherwise
_SAME_PLACE = 0.01  # [m]
_SAME_RANGE = 1e-3  # [m]


class CameraPart(NamedTuple):
    """An optical frame, and how it can be moved against the base.

    Attributes:
        frame: its link.
        joints: that move it, from the base on, without those that follow others; empty where it
            is fixed on the base.
        right: optical frame of the right camera of a stereo pair, or empty.
        baseline: of that pair [m], or 0.
    """

    frame: str
    joints: tuple[str, ...]
    right: str = ""
    baseline: float = 0.0


class ArmEnd(NamedTuple):
    """Where an arm ends, before the fingers of a hand.

    Attributes:
        link: the last link that its joints carry, by name a tool's where there is one.
        joints: joints that move it, from the base on.
        outward: the axis of `link`, +-1 in one coordinate, that leads away from the arm, (3,).
        length: how far the solids behind its last joint reach along `outward` from `link` [m].
    """

    link: str
    joints: tuple[str, ...]
    outward: FloatArray
    length: float


def find_cameras(robot: RobotModel) -> list[CameraPart]:
    """Optical frames, those first that most joints move.

    A frame is optical by its name, as REP 103 has it; two that only a translation along x
    separates, and which are called left and right, infra1 and infra2, or l and r, are a pair.
    Of those that equally many joints move, pairs with at least `LEAST_BASELINE` come first, then
    left, then color.
    """
    frames = [f for f in robot.frames if _OPTICAL.search(f) and not _NO_IMAGES.search(f)]
    cameras = []
    for frame in frames:
        joints = joints_between(robot, frame)
        right, baseline = _right_of(robot, frame, frames)
        cameras.append(CameraPart(frame, joints, right, baseline))
    rights = {camera.right for camera in cameras if camera.right}
    return sorted(
        (camera for camera in cameras if camera.frame not in rights),
        key=lambda c: (-len(c.joints), c.baseline < LEAST_BASELINE, _preference(c.frame)),
    )


def joints_between(robot: RobotModel, frame: str) -> tuple[str, ...]:
    """Joints with a position of their own that move a link against the base, from the base on."""
    model = robot.model
    joints = [_joint_of(robot, robot.base_frame), _joint_of(robot, frame)]
    base, end = ([int(index) for index in model.supports[joint]] for joint in joints)
    owners = [robot.mechanism.owner_of(index) for index in end if index not in base]
    names = [str(model.names[index]) for index in dict.fromkeys(owners)]
    held = {joint.name for joint in robot.joints if joint.lower == joint.upper}
    return tuple(name for name in names if name not in held)


def find_arm_ends(robot: RobotModel) -> list[ArmEnd]:
    """Ends of the arms, those first that most joints move; fingers are no part of an arm."""
    model = robot.model
    moving = {int(model.parents[index]) for index in range(1, model.njoints)}
    tips = dict.fromkeys(
        _without_hand(robot, index) for index in range(1, model.njoints) if index not in moving
    )
    ends = [end for tip in tips if tip > 0 and (end := _arm_end(robot, tip)) is not None]
    return sorted(ends, key=lambda end: (-len(end.joints), "right" in end.link))


def find_telescopes(robot: RobotModel) -> dict[str, str]:
    """Joints that follow another, as the segments of a telescope do that one motor drives.

    Two or more joints in a row that slide in one direction over the same range; the first leads.

    Returns:
        Leader of each follower.
    """
    model, followers = robot.model, dict[str, str]()
    limits = {joint.name: joint for joint in robot.joints}
    for index in range(1, model.njoints):
        name, above = str(model.names[index]), int(model.parents[index])
        before = str(model.names[above])
        if above == 0 or name not in limits or before not in limits:
            continue
        if not (robot.mechanism.slides(index) and robot.mechanism.slides(above)):
            continue
        ranges = [(limits[n].lower, limits[n].upper) for n in (name, before)]
        axes = [joint_axis(robot, joint) for joint in (index, above)]
        alike = np.allclose(ranges[0], ranges[1], atol=_SAME_RANGE)
        if alike and axes[0] @ axes[1] > 1.0 - 1e-6:
            followers[name] = followers.get(before, before)
    return followers


def _preference(frame: str) -> int:
    return next(n for n, words in enumerate(_PREFERRED) if re.search(words, frame))


def _right_of(robot: RobotModel, frame: str, frames: list[str]) -> tuple[str, float]:
    """The right camera of the pair of which a frame is the left, and the baseline [m]."""
    for left, right in _SIDES:
        others = [frame.replace(left, right, 1)] if left in frame else []
        for other in others:
            if other not in frames or _joint_of(robot, other) != _joint_of(robot, frame):
                continue
            offset = invert_transform(_placement(robot, frame)) @ _placement(robot, other)
            if np.abs(offset[:3, :3] - np.eye(3)).max() > _PARALLEL or offset[0, 3] <= 0.0:
                continue
            if np.abs(offset[1:3, 3]).max() < _PARALLEL:
                return other, float(offset[0, 3])
    return "", 0.0


def _without_hand(robot: RobotModel, joint: int) -> int:
    """The last joint of the arm on the way from a tip to the base; 0 for none."""
    model, mechanism = robot.model, robot.mechanism
    leaders = {mechanism.owner_of(index) for index in range(1, model.njoints)}
    leaders -= {index for index in leaders if _is_in_row(robot, index)}
    while joint > 0:
        follows = mechanism.owner_of(joint) != joint
        leads = joint in leaders
        if not (follows or leads or _HAND.search(str(model.names[joint]))):
            return joint
        joint = int(model.parents[joint])
    return 0


def _is_in_row(robot: RobotModel, leader: int) -> bool:
    """Whether no joint beside it follows a joint, as the second finger of a gripper does."""
    model, owner_of = robot.model, robot.mechanism.owner_of
    followers = [i for i in range(1, model.njoints) if owner_of(i) == leader and i != leader]
    return not any(model.parents[index] == model.parents[leader] for index in followers)


def _arm_end(robot: RobotModel, joint: int) -> ArmEnd | None:
    """The end of the arm whose last joint this is; None where it has no link of its own."""
    model = robot.model
    links = [
        str(f.name)
        for f in model.frames
        if int(f.parentJoint) == joint and f.type == pinocchio.FrameType.BODY
    ]
    if not links:
        return None
    plain = [link for link in links if not (_OPTICAL.search(link) or _HAND.search(link))]
    tools = [link for link in plain if _TOOL.search(link)]
    candidates = tools or plain or links
    far = [np.linalg.norm(_placement(robot, link)[:3, 3]) for link in candidates]
    link = candidates[int(np.argmax(far))]
    outward = _outward(robot, joint, link)
    return ArmEnd(link, joints_between(robot, link), outward, _length(robot, joint, link, outward))


def _outward(robot: RobotModel, joint: int, link: str) -> FloatArray:
    """The axis of a link that leads away from the joint before it which is not at its place."""
    model = robot.model
    data = model.createData()
    pinocchio.forwardKinematics(model, data, robot.mechanism.resting({}))
    T_joint_link = _placement(robot, link)
    T_root_link = np.array(data.oMi[joint].homogeneous) @ T_joint_link
    while joint > 0:
        offset = T_root_link[:3, 3] - data.oMi[joint].translation
        if np.linalg.norm(offset) > _SAME_PLACE:
            local = T_root_link[:3, :3].T @ offset
            axis = int(np.argmax(np.abs(local)))
            return np.asarray(np.sign(local[axis]) * np.eye(3)[axis])
        joint = int(model.parents[joint])
    return np.array([0.0, 0.0, 1.0])


def _length(robot: RobotModel, joint: int, link: str, outward: FloatArray) -> float:
    """How far solids behind a joint reach along an axis of a link from it, at least 0 [m]."""
    model = robot.model
    joints = {each.name: each.rest for each in robot.joints}
    solids = robot.solids_in(link, joints)
    reach = [0.0]
    for shape, solid in zip(robot.shapes, solids, strict=True):
        if joint not in model.supports[shape.joint]:
            continue
        vertices = shape.vertices
        if vertices is not None:
            points = vertices @ solid.transform[:3, :3].T + solid.transform[:3, 3]
            reach.append(float((points @ outward).max()))
        else:
            middle = float(solid.transform[:3, 3] @ outward)
            reach.append(middle + solid.solid.bounding_radius)
    return max(reach)


def _joint_of(robot: RobotModel, frame: str) -> int:
    model = robot.model
    return int(model.frames[model.getFrameId(frame, pinocchio.FrameType.BODY)].parentJoint)


def _placement(robot: RobotModel, frame: str) -> FloatArray:
    """Of a link in the frame of the joint that moves it, shape (4, 4)."""
    model = robot.model
    item = model.frames[model.getFrameId(frame, pinocchio.FrameType.BODY)]
    return np.array(item.placement.homogeneous)
