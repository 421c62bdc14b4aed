"""What is read of robots that nobody here designed; the truth are their makers' names."""

from __future__ import annotations

import re
from functools import cache
from xml.etree import ElementTree

import numpy as np
import pytest

from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.robots.camera_parts import (
    find_arm_ends,
    find_cameras,
    find_telescopes,
    find_wheels,
)

from .known_robots import TELESCOPE, installed

STRETCH = "SE3_eoa_wrist_dw3_tool_sg3.urdf"
ROBOTS = {
    "tiago": "robots/tiago_no_hand.urdf",
    "tiago_hand": "robots/tiago.urdf",
    "tiago_dual": "robots/tiago_dual.urdf",
    "tiago_pro": "robots/tiago_pro.urdf",
    "pr2": "urdf/pr2.urdf",
    "ur5": "ur5_robot.urdf",
    "panda": "urdf/panda.urdf",
}


@cache
def robot(name: str) -> RobotModel:
    if name == "rover":
        return RobotModel.from_urdf(find_share("config/rover.urdf"))
    if name == "stretch":
        return RobotModel.from_urdf(installed("hello-robot-stretch-urdf", STRETCH))
    urdf = installed("example-robot-data", ROBOTS[name])
    return RobotModel.from_urdf(urdf, package_folders=[urdf.parents[4]])


@pytest.mark.parametrize("name", ["rover", "stretch", "tiago", "tiago_dual", "tiago_pro"])
def test_driven_wheels_are_those_called_so_on_their_sides(name):
    model = robot(name)
    joints = [joint.name for joint in model.joints if "wheel" in joint.name]
    wheels = find_wheels(model)
    assert set(wheels.left) == {joint for joint in joints if "left" in joint}
    assert set(wheels.right) == {joint for joint in joints if "right" in joint}


@pytest.mark.parametrize("name", ["rover", "stretch", "tiago", "tiago_dual", "tiago_pro"])
def test_casters_are_those_called_so_that_have_solids(name):
    model, wheels = robot(name), find_wheels(robot(name))
    called = {link for link in model.links_with_solids if "caster" in link}
    if name == "tiago_dual":  # its casters' upper links are solid too, and off the ground
        called = {link for link in called if link.endswith("_2_link")}
    assert set(wheels.casters) == called


def test_a_base_that_is_drawn_to_the_ground_hovers():
    assert find_wheels(robot("stretch")).hovering == ("base_link",)
    assert find_wheels(robot("tiago")).hovering == ()


@pytest.mark.parametrize("name", ["pr2", "ur5", "panda"])
def test_robots_without_wheels_that_turn_have_none(name):
    assert find_wheels(robot(name))[:4] == ((), (), (), ())


def test_wheels_do_not_depend_on_names():
    xml = find_share("config/rover.urdf").read_text("utf-8")
    xml = re.sub(r"(front|rear)_(left|right)_wheel", lambda m: f"part_{m[1][0]}{m[2][0]}", xml)
    wheels = find_wheels(RobotModel.from_urdf(xml))
    assert wheels.left == ("part_fl_joint", "part_rl_joint")
    assert wheels.right == ("part_fr_joint", "part_rr_joint")
    assert wheels.ground == pytest.approx(-0.0762)


def test_the_wheel_of_a_swivel_is_a_caster():
    """A wheel behind a joint that turns about the vertical is driven by nothing."""
    tree = ElementTree.fromstring(find_share("config/rover.urdf").read_text("utf-8"))
    axle = next(j for j in tree.findall("joint") if j.get("name") == "rear_left_wheel_joint")
    axle.find("parent").set("link", "swivel")
    tree.append(ElementTree.fromstring("<link name='swivel'/>"))
    swivel = "<joint name='turn' type='continuous'><parent link='base_link'/>"
    swivel += "<child link='swivel'/><axis xyz='0 0 1'/></joint>"
    tree.append(ElementTree.fromstring(swivel))
    wheels = find_wheels(RobotModel.from_urdf(ElementTree.tostring(tree, encoding="unicode")))
    assert wheels.left == ("front_left_wheel_joint",)
    assert wheels.casters == ("rear_left_wheel",)


@pytest.mark.parametrize(
    ("name", "frame", "joints", "right", "baseline"),
    [
        ("rover", "left_camera_optical_frame", 4, "right_camera_optical_frame", 0.1016),
        ("stretch", "gripper_camera_color_optical_frame", 8, "", 0.0),
        ("tiago", "xtion_rgb_optical_frame", 3, "", 0.0),
        ("pr2", "l_forearm_cam_optical_frame", 6, "", 0.0),
    ],
)
def test_the_camera_that_most_joints_move_is_first(name, frame, joints, right, baseline):
    camera = find_cameras(robot(name))[0]
    assert (camera.frame, len(camera.joints), camera.right) == (frame, joints, right)
    assert camera.baseline == pytest.approx(baseline)


def test_pairs_are_those_of_the_descriptions():
    pairs = {c.frame: c for c in find_cameras(robot("pr2")) if c.right}
    assert len(pairs) == 2
    assert all(pair.baseline == pytest.approx(0.09) for pair in pairs.values())
    near = next(c for c in find_cameras(robot("stretch")) if "gripper" in c.frame and c.right)
    assert near.right == "gripper_camera_infra2_optical_frame"
    assert near.baseline == pytest.approx(0.018)


@pytest.mark.parametrize("name", ["rover", "stretch", "pr2"])
def test_the_joints_of_a_camera_are_those_of_its_chain(name):
    camera = find_cameras(robot(name))[0]
    source = robot(name)
    model = RobotModel(source.mechanism, source.shapes, source.base_frame, camera.frame)
    assert camera.joints == model.arm.joint_names


@pytest.mark.parametrize(
    ("name", "link", "joints"),
    [
        ("tiago", "wrist_ft_tool_link", 8),
        ("tiago_hand", "wrist_ft_tool_link", 8),
        ("tiago_pro", "arm_left_tool_link", 8),
        ("ur5", "tool0", 6),
        ("panda", "panda_link8", 7),
    ],
)
def test_arms_end_before_their_hands(name, link, joints):
    end = find_arm_ends(robot(name))[0]
    assert (end.link, len(end.joints)) == (link, joints)
    assert np.abs(end.outward).sum() == 1.0


def test_an_arm_with_a_hand_is_longer_by_the_hand():
    bare, hand = (find_arm_ends(robot(name))[0].length for name in ("tiago", "tiago_hand"))
    assert hand > bare + 0.1


def test_a_telescope_is_found_and_nothing_else():
    assert find_telescopes(robot("stretch")) == TELESCOPE
    assert not any(find_telescopes(robot(name)) for name in ("rover", "tiago", "panda", "pr2"))
