"""What a simulator must know of a robot, completed from its description."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from infomap_ros.errors import ConfigError, RobotModelError
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.body.extended_description import (
    CART_CASTERS,
    CART_WHEELS,
    DEFAULT_CAMERA,
    extended_description,
    mend_inertias,
    root_link,
)
from infomap_ros.simulation.body.robot import unreadable_meshes
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.robots.camera_parts import find_cameras, find_wheels, joints_between

_LEAST_BASELINE = 0.005  # [m]


class ReadyRobot(NamedTuple):
    """A robot that can be simulated.

    Attributes:
        description: URDF text, with the camera and the cart that the setup adds.
        setup: nothing that is needed is empty.
        mended: links whose inertias or meshes cannot be used as they are, and what was done.
    """

    description: str
    setup: RobotSetupConfig
    mended: tuple[str, ...]


def ready_robot(description: str, setup: RobotSetupConfig) -> ReadyRobot:
    """Complete a setup from the robot's description, and guess nothing.

    Args:
        description: URDF text.
        setup: what is not empty counts.

    Raises:
        ConfigError: a part is neither given nor to be read from the description; names it as
            ``robot.<field>``.
        RobotModelError: the description is malformed.
    """
    text = extended_description(description, setup)
    tree = ElementTree.fromstring(text)
    if not setup.base_frame:
        setup = replace(setup, base_frame=root_link(tree))
    if setup.camera_mount and not setup.left_camera_frame:
        setup = replace(setup, left_camera_frame=DEFAULT_CAMERA)
    model = RobotModel.from_urdf(text, base_frame=setup.base_frame, mimics=setup.leaders)
    setup = _with_wheels(model, setup)
    setup = _with_camera(model, setup)
    if not setup.arm_joints:
        joints = joints_between(model, _known_frame(model, setup.left_camera_frame))
        if setup.home and len(setup.home) != len(joints):
            expected = f"{len(joints)} numbers, for {', '.join(joints)}"
            raise ConfigError("robot.home", setup.home, expected)
        setup = replace(setup, arm_joints=joints)
    if not setup.home:
        start = initial_positions(tree)
        setup = replace(setup, home=tuple(start.get(name, 0.0) for name in setup.arm_joints))
    return ReadyRobot(text, setup, mended_parts(text))


def mended_parts(description: str) -> tuple[str, ...]:
    """Links whose inertias or meshes cannot be used as they are, and what is done, in words.

    Args:
        description: URDF text.
    """
    inertias = mend_inertias(ElementTree.fromstring(description))
    meshes = unreadable_meshes(description)
    found = [f"link '{item.link}': {item.problem}" for item in inertias]
    if meshes:
        links = ", ".join(meshes[:3]) + (f" and {len(meshes) - 3} more" * (len(meshes) > 3))
        found.append(f"collision meshes of {links}: read as triangles, without their colors")
    return tuple(found)


def _with_wheels(model: RobotModel, setup: RobotSetupConfig) -> RobotSetupConfig:
    if setup.left_wheels and setup.right_wheels:
        return setup
    if setup.cart:
        left, right = CART_WHEELS
        return replace(setup, left_wheels=left, right_wheels=right, casters=CART_CASTERS)
    wheels = find_wheels(model)
    for name, found in (("left_wheels", wheels.left), ("right_wheels", wheels.right)):
        if not getattr(setup, name) and not found:
            expected = (
                f"the joints of the driven {name.replace('_', ' ')}, which the description does "
                "not show; or robot.cart, which puts the robot on wheels"
            )
            raise ConfigError(f"robot.{name}", (), expected)
    return replace(
        setup,
        left_wheels=setup.left_wheels or wheels.left,
        right_wheels=setup.right_wheels or wheels.right,
        casters=setup.casters or wheels.casters,
        hovering=setup.hovering or wheels.hovering,
    )


def _with_camera(model: RobotModel, setup: RobotSetupConfig) -> RobotSetupConfig:
    cameras = {camera.frame: camera for camera in find_cameras(model)}
    left = setup.left_camera_frame
    if not left:
        if not cameras:
            expected = "an optical frame; robot.camera_mount adds one"
            raise ConfigError("robot.left_camera_frame", "", expected)
        left, *others = cameras
        rivals = [f for f in others if len(cameras[f].joints) == len(cameras[left].joints)]
        if rivals:
            expected = f"one of {', '.join([left, *rivals])}"
            raise ConfigError("robot.left_camera_frame", "", expected)
    _known_frame(model, left)
    right = setup.right_camera_frame
    if not right and setup.baseline == 0.0 and left in cameras:
        right = cameras[left].right
    if not right and setup.baseline < _LEAST_BASELINE:
        expected = f"at least {_LEAST_BASELINE} m, as there is no robot.right_camera_frame"
        raise ConfigError("robot.baseline", setup.baseline, expected)
    return replace(setup, left_camera_frame=left, right_camera_frame=right)


def _known_frame(model: RobotModel, frame: str) -> str:
    if frame not in model.frames:
        raise RobotModelError(f"the robot has no frame '{frame}'")
    return frame


def initial_positions(tree: ElementTree.Element) -> Mapping[str, float]:
    """Start positions in ``<ros2_control>`` by joint [rad or m], as Gazebo and mock drivers do.

    Raises:
        RobotModelError: one is no number.
    """
    found = {}
    for joint in tree.iterfind("ros2_control/joint"):
        state = joint.find("state_interface[@name='position']/param[@name='initial_value']")
        if state is not None:
            name = joint.get("name", "")
            try:
                found[name] = float(state.text or "")
            except ValueError as error:
                text = f"joint '{name}' has the initial_value '{state.text}' in <ros2_control>"
                raise RobotModelError(text) from error
    return found
