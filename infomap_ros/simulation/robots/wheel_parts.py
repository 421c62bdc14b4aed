"""Which parts of a robot its weight rests on: driven wheels, casters, and what hangs low."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio

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
