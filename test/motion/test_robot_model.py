"""The robot model against poses computed by hand and with scipy."""

from __future__ import annotations

import math
import re
import struct
import threading
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import Box, ConvexPolytope, Cylinder, Sphere, make_transform
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.robot.robot_model import RobotModel

REPOSITORY = Path(__file__).resolve().parents[2]

ARM = """
<robot name="arm">
  <link name="base">
    <collision><origin xyz="0 0 0.1"/><geometry><box size="0.4 0.2 0.1"/></geometry></collision>
  </link>
  <link name="upper">
    <collision><origin xyz="0.25 0 0" rpy="0 1.5707963267948966 0"/>
      <geometry><cylinder radius="0.05" length="0.5"/></geometry></collision>
  </link>
  <link name="slider"/>
  <link name="camera"><collision><geometry><sphere radius="0.04"/></geometry></collision></link>
  <link name="camera_optical_frame"/>
  <link name="wheel"/>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="2" effort="1" velocity="0.5"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="upper"/><child link="slider"/><origin xyz="0.5 0 0"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.3" effort="1" velocity="0.1"/>
  </joint>
  <joint name="mount" type="fixed">
    <parent link="slider"/><child link="camera"/><origin xyz="0 0 0.1"/>
  </joint>
  <joint name="optics" type="fixed">
    <parent link="camera"/><child link="camera_optical_frame"/>
    <origin rpy="-1.5707963267948966 0 -1.5707963267948966"/>
  </joint>
  <joint name="roll" type="continuous">
    <parent link="base"/><child link="wheel"/><origin xyz="0.1 0.2 0"/><axis xyz="0 1 0"/>
  </joint>
</robot>
"""

SPHERE = '<collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.1"/></geometry></collision>'

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def write_stl(path: Path, vertices: np.ndarray, faces: list[tuple[int, int, int]]) -> None:
    triangles = [struct.pack("<12fH", *[0.0] * 3, *vertices[list(f)].ravel(), 0) for f in faces]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + b"".join(triangles))


def one_link(geometry: str, name: str = "tool") -> str:
    return (
        f'<robot name="r"><link name="{name}"><collision><geometry>{geometry}</geometry>'
        "</collision></link></robot>"
    )


@pytest.fixture
def arm() -> RobotModel:
    return RobotModel.from_urdf(ARM, camera_frame="camera_optical_frame")


def test_joints_and_limits_are_those_of_the_urdf(arm):
    joints = {joint.name: joint for joint in arm.joints}
    assert set(joints) == {"turn", "slide", "roll"}
    assert (joints["turn"].lower, joints["turn"].upper, joints["turn"].velocity) == (-1, 2, 0.5)
    assert (joints["slide"].lower, joints["slide"].upper) == (0.0, 0.3)
    assert joints["roll"].is_continuous
    assert (joints["roll"].lower, joints["roll"].upper) == (-math.inf, math.inf)


def test_frames_are_the_links(arm):
    assert set(arm.frames) == {
        "base", "upper", "slider", "camera", "camera_optical_frame", "wheel",
    }  # fmt: skip
    assert (arm.name, arm.base_frame, arm.camera_frame) == ("arm", "base", "camera_optical_frame")


def test_forward_kinematics_by_hand(arm):
    """Turn by 90 deg, slide by 0.2 m: the camera looks along +y from (0, 0.7, 0.3)."""
    T_base_camera = arm.forward_kinematics(
        {"turn": math.pi / 2, "slide": 0.2}, "camera_optical_frame"
    )
    expected = make_transform([[1, 0, 0], [0, 0, 1], [0, -1, 0]], [0.0, 0.7, 0.3])
    np.testing.assert_allclose(T_base_camera, expected, atol=1e-12)


def test_continuous_joint_turns_beyond_a_turn(arm):
    T_base_wheel = arm.forward_kinematics({"roll": 7.0}, "wheel")
    np.testing.assert_allclose(
        T_base_wheel[:3, :3], Rotation.from_rotvec([0, 7.0, 0]).as_matrix(), atol=1e-12
    )


def test_random_poses_agree_with_composed_rotations(arm, rng):
    for turn, slide in rng.uniform([-1, 0], [2, 0.3], size=(20, 2)):
        T_base_upper = make_transform(Rotation.from_rotvec([0, 0, turn]).as_matrix(), [0, 0, 0.2])
        T_upper_camera = make_transform(np.eye(3), [0.5 + slide, 0, 0.1])
        np.testing.assert_allclose(
            arm.forward_kinematics({"turn": turn, "slide": slide}, "camera"),
            T_base_upper @ T_upper_camera,
            atol=1e-12,
        )


def test_another_base_frame(arm):
    positions = {"turn": 0.4, "slide": 0.1}
    other = RobotModel.from_urdf(ARM, base_frame="upper")
    expected = np.linalg.inv(arm.forward_kinematics(positions, "upper"))
    np.testing.assert_allclose(
        other.forward_kinematics(positions, "camera"),
        expected @ arm.forward_kinematics(positions, "camera"),
        atol=1e-12,
    )


def test_solids_are_placed_in_the_frame_asked_for(arm):
    positions = {"turn": 0.7, "slide": 0.25, "unrelated": 3.0}
    solids = {s.name: s for s in arm.solids_in("camera_optical_frame", positions)}
    assert set(solids) == set(arm.links_with_solids) == {"base", "upper", "camera"}
    assert solids["base"].solid == Box((0.4, 0.2, 0.1))
    assert solids["upper"].solid == Cylinder(0.05, 0.5)
    assert solids["camera"].solid == Sphere(0.04)
    T_camera_base = np.linalg.inv(arm.forward_kinematics(positions, "camera_optical_frame"))
    T_base_upper = arm.forward_kinematics(positions, "upper")
    lying = make_transform(Rotation.from_rotvec([0, math.pi / 2, 0]).as_matrix(), [0.25, 0, 0])
    np.testing.assert_allclose(
        solids["base"].transform, T_camera_base @ make_transform(np.eye(3), [0, 0, 0.1]), atol=1e-12
    )
    np.testing.assert_allclose(
        solids["upper"].transform, T_camera_base @ T_base_upper @ lying, atol=1e-12
    )


def test_mimic_joint_follows_its_leader():
    urdf = ARM.replace(
        '<child link="slider"/>', '<child link="slider"/><mimic joint="turn" multiplier="0.1"/>'
    )
    robot = RobotModel.from_urdf(urdf)
    assert {joint.name for joint in robot.joints} == {"turn", "roll"}
    T_upper_slider = np.linalg.inv(
        robot.forward_kinematics({"turn": 1.5}, "upper")
    ) @ robot.forward_kinematics({"turn": 1.5}, "slider")
    np.testing.assert_allclose(T_upper_slider[:3, 3], [0.65, 0, 0], atol=1e-12)
    with pytest.raises(RobotModelError, match="'turn'"):
        robot.forward_kinematics({}, "slider")


def test_missing_joint_is_named(arm):
    with pytest.raises(RobotModelError, match="'slide'"):
        arm.forward_kinematics({"turn": 0.0}, "camera")
    with pytest.raises(RobotModelError, match="'slide', 'turn'"):
        arm.solids_in("base", {"roll": 0.0})


def test_joints_that_do_not_matter_may_be_missing(arm):
    assert len(arm.solids_in("base", {"turn": 0.0, "slide": 0.0})) == 3
    arm.forward_kinematics({"turn": 0.0}, "upper")


def test_position_that_is_no_number_is_named(arm):
    with pytest.raises(RobotModelError, match="'slide' is nan"):
        arm.forward_kinematics({"turn": 0.0, "slide": math.nan}, "camera")


def test_unknown_frames_and_joints_are_named(arm):
    with pytest.raises(RobotModelError, match="no frame 'hand'"):
        arm.forward_kinematics({}, "hand")
    with pytest.raises(RobotModelError, match="no frame 'eye'"):
        RobotModel.from_urdf(ARM, camera_frame="eye")
    with pytest.raises(RobotModelError, match=r"no joint 'jump'.*turn"):
        arm.joint("jump")
    with pytest.raises(RobotModelError, match="no frame 'universe'"):
        arm.solids_in("universe", {"turn": 0.0, "slide": 0.0})


@pytest.mark.parametrize(
    ("urdf", "named"),
    [
        ("<robot", "line 1"),
        ("<robot name='a'/>", "no links"),
        ("<sdf/>", "<sdf>"),
        (ARM.replace('name="upper"', 'name="base"', 1), "2 links are named 'base'"),
        (ARM.replace('type="continuous"', 'type="floating"'), "'roll' has the type 'floating'"),
        (ARM.replace('<child link="wheel"/>', '<child link="foot"/>'), "'roll'.*'foot'"),
        (ARM.replace('<child link="wheel"/>', '<child link="camera"/>'), "'camera' is the child"),
        (ARM.replace("</robot>", '<link name="loose"/></robot>'), "'base', 'loose'"),
        (ARM.replace('<limit lower="0" upper="0.3" effort="1" velocity="0.1"/>', ""), "'slide'"),
        (one_link('<capsule radius="1" length="1"/>'), "'tool'.*capsule"),
        (one_link(""), "'tool'.*nothing"),
        (one_link('<box size="1 1"/>'), "0 of 1 collision shapes"),
        (
            '<robot name="r"><link name="a"/><link name="b"/><link name="c"/>'
            '<joint name="i" type="fixed"><parent link="b"/><child link="c"/></joint>'
            '<joint name="j" type="fixed"><parent link="c"/><child link="b"/></joint></robot>',
            "loop",
        ),
    ],
)
def test_malformed_description_is_refused_with_the_culprit(urdf, named):
    with pytest.raises(RobotModelError, match=named):
        RobotModel.from_urdf(urdf)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(RobotModelError, match=r"absent\.urdf: No such file"):
        RobotModel.from_urdf(tmp_path / "absent.urdf")


def test_binary_file_is_named(tmp_path):
    (tmp_path / "robot.urdf").write_bytes(b"\xff\xfe\x00binary")
    with pytest.raises(RobotModelError, match=r"robot\.urdf is not UTF-8"):
        RobotModel.from_urdf(tmp_path / "robot.urdf")


def test_mesh_of_a_package_becomes_its_scaled_hull(tmp_path, rng):
    write_stl(tmp_path / "share" / "tools" / "a.stl", TETRAHEDRON, FACES)
    urdf = one_link('<mesh filename="package://tools/a.stl" scale="2 1 1"/>')
    robot = RobotModel.from_urdf(urdf, package_folders=[tmp_path / "share"])
    (placed,) = robot.solids_in("tool", {})
    assert isinstance(placed.solid, ConvexPolytope)
    points = rng.uniform(-0.2, 2.2, size=(2000, 3))
    inside = (points >= 0).all(axis=1) & (points @ [0.5, 1.0, 1.0] <= 1.0)
    assert inside.any()
    np.testing.assert_array_equal(placed.solid.signed_distance(points) <= 0.0, inside)


def test_mesh_beside_the_description_is_found(tmp_path):
    write_stl(tmp_path / "meshes" / "a.stl", TETRAHEDRON, FACES)
    (tmp_path / "robot.urdf").write_text(one_link('<mesh filename="meshes/a.stl"/>'))
    (placed,) = RobotModel.from_urdf(tmp_path / "robot.urdf").solids_in("tool", {})
    assert len(placed.solid.offsets) == 4


def test_flat_mesh_becomes_a_plate(tmp_path):
    square = np.array([[0, 0, 2], [1, 0, 2], [1, 1, 2], [0, 1, 2]], dtype=float)
    write_stl(tmp_path / "tag.stl", square, [(0, 1, 2), (0, 2, 3)])
    robot = RobotModel.from_urdf(one_link('<mesh filename="tag.stl"/>'), package_folders=[tmp_path])
    (placed,) = robot.solids_in("tool", {})
    distance = placed.solid.signed_distance([[0.5, 0.5, 2.0004], [0.5, 0.5, 2.0006], [1.1, 0.5, 2]])
    np.testing.assert_array_equal(distance <= 0.0, [True, False, False])


@pytest.mark.parametrize(
    ("shape", "named", "is_missing"),
    [
        ('<sphere radius="-1"/>', "'tool'.*positive", False),
        ('<box size="0 0 0"/>', "'tool'.*positive", False),
        ('<mesh filename="package://nowhere/a.stl"/>', "'tool'.*package://nowhere/a.stl", True),
    ],
)
def test_shape_that_cannot_be_had_is_left_out_and_named(shape, named, is_missing):
    robot = RobotModel.from_urdf(one_link(shape))
    assert robot.solids_in("tool", {}) == []
    (sentence,) = robot.left_out
    assert re.search(named, sentence)
    assert robot.missing == (robot.left_out if is_missing else ())


def test_the_other_shapes_of_a_robot_with_a_missing_mesh_are_kept():
    missing = (
        '<collision><geometry><mesh filename="package://nowhere/a.stl"/></geometry></collision>'
    )
    urdf = ARM.replace('<link name="slider"/>', f'<link name="slider">{missing}</link>')
    robot = RobotModel.from_urdf(urdf)
    assert len(robot.missing) == 1
    assert len(robot.shapes) == len(RobotModel.from_urdf(ARM).shapes)
    with pytest.raises(RobotModelError, match=r"no motion can be planned without .*nowhere/a\.stl"):
        CollisionBody.from_robot(robot)


@pytest.mark.parametrize(
    ("limit", "named"),
    [
        ('effort="-1" velocity="1"', "'slide' has effort='-1'"),
        ('velocity="1"', "'slide' has no effort"),
    ],
)
def test_limit_that_is_none_names_its_joint(limit, named):
    urdf = ARM.replace('effort="1" velocity="0.1"', limit)
    with pytest.raises(RobotModelError, match=named):
        RobotModel.from_urdf(urdf)


def test_prefix_that_nothing_declares_is_no_error():
    extension = '<gazebo><sensor:camera name="c" xlink:href="x"/></gazebo></robot>'
    assert RobotModel.from_urdf(ARM.replace("</robot>", extension)).frames


def test_mesh_in_one_line_is_left_out(tmp_path):
    line = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2]], dtype=float)
    write_stl(tmp_path / "a.stl", line, [(0, 1, 2)])
    robot = RobotModel.from_urdf(one_link('<mesh filename="a.stl"/>'), package_folders=[tmp_path])
    assert "'tool'" in robot.left_out[0]


def test_threads_do_not_disturb_each_other(arm):
    wrong: list[float] = []

    def work(turn: float) -> None:
        expected = arm.forward_kinematics({"turn": turn, "slide": 0.0}, "camera")
        for _ in range(300):
            again = arm.forward_kinematics({"turn": turn, "slide": 0.0}, "camera")
            wrong.extend([turn] * (not np.array_equal(again, expected)))

    threads = [threading.Thread(target=work, args=(0.3 * i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_rover_camera_stands_where_the_printed_lengths_put_it():
    """Arm upright: wheel axles to deck mount 0.11, then 138.2, 344.2, 228.6 and 89.3 mm."""
    rover = RobotModel.from_urdf(
        REPOSITORY / "config" / "rover.urdf", camera_frame="left_camera_optical_frame"
    )
    upright = {joint.name: 0.0 for joint in rover.joints}
    T_base_left = rover.forward_kinematics(upright, rover.camera_frame)
    T_base_right = rover.forward_kinematics(upright, "right_camera_optical_frame")
    np.testing.assert_allclose(T_base_left[:3, 2], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(T_base_left[:3, 0], [0, -1, 0], atol=1e-6)
    baseline = np.linalg.inv(T_base_left) @ T_base_right[:, 3]
    np.testing.assert_allclose(baseline[:3], [0.1016, 0, 0], atol=1e-6)
    T_base_wrist = rover.forward_kinematics(upright, "arm_wrist")
    assert T_base_wrist[2, 3] == pytest.approx(0.11 + 0.1382 + 0.3442 + 0.2286)


def test_joints_that_carry_both_frames_may_be_missing():
    """Between the upper arm and the camera only the slide moves."""
    robot = RobotModel.from_urdf(ARM, base_frame="upper")
    pose = robot.forward_kinematics({"slide": 0.2}, "camera")
    np.testing.assert_allclose(pose, make_transform(np.eye(3), [0.7, 0.0, 0.1]), atol=1e-12)
    with pytest.raises(RobotModelError, match="no position of joint 'slide'"):
        robot.forward_kinematics({"turn": 0.2}, "camera")


def test_a_joint_that_nobody_reports_can_be_assumed():
    xml = ARM.replace('<link name="wheel"/>', f'<link name="wheel">{SPHERE}</link>')
    positions = {"turn": 0.3, "slide": 0.1}
    with pytest.raises(RobotModelError, match="no position of joint 'roll'"):
        RobotModel.from_urdf(xml).solids_in("camera", positions)
    robot = RobotModel.from_urdf(xml, assumed_joints=["roll"])
    assumed, told, at_zero = (
        {solid.name: solid.transform for solid in robot.solids_in("camera", positions | more)}
        for more in ({}, {"roll": 1.0}, {"roll": 0.0})
    )
    np.testing.assert_equal(assumed, at_zero)
    assert not np.allclose(assumed["wheel"], told["wheel"])


def test_an_assumed_joint_stands_at_its_limit_nearest_to_zero():
    xml = ARM.replace('lower="0" upper="0.3"', 'lower="0.2" upper="0.3"')
    robot = RobotModel.from_urdf(xml, "camera", assumed_joints=["slide"])
    np.testing.assert_array_equal(
        robot.forward_kinematics({"turn": 0.0}, "camera"),
        robot.forward_kinematics({"turn": 0.0, "slide": 0.2}, "camera"),
    )


def test_a_joint_without_a_range_needs_no_position():
    xml = ARM.replace('lower="-1" upper="2"', 'lower="0.5" upper="0.5"')
    robot = RobotModel.from_urdf(xml, "camera")
    np.testing.assert_array_equal(
        robot.forward_kinematics({"slide": 0.1}, "camera"),
        robot.forward_kinematics({"slide": 0.1, "turn": 0.5}, "camera"),
    )


def test_an_unknown_joint_cannot_be_assumed():
    with pytest.raises(RobotModelError, match="no joint 'wheel' whose position can be assumed"):
        RobotModel.from_urdf(ARM, assumed_joints=["wheel"])


def test_what_is_seen_beyond_the_solids_is_placed_with_them(tmp_path: Path) -> None:
    """A cover without a solid, a link drawn larger than its solid, and one drawn as it is."""
    write_stl(tmp_path / "cover.stl", TETRAHEDRON, FACES)
    drawn = {
        "slider": '<visual><geometry><mesh filename="cover.stl"/></geometry></visual>',
        "upper": """<visual><origin xyz="0.25 0 0" rpy="0 1.5707963267948966 0"/>
            <geometry><cylinder radius="0.08" length="0.5"/></geometry></visual>""",
        "base": """<visual><origin xyz="0 0 0.1"/>
            <geometry><box size="0.4 0.2 0.1"/></geometry></visual>""",
        "wheel": '<visual><geometry><mesh filename="nowhere.stl"/></geometry></visual>',
    }
    text = ARM.replace('<link name="slider"/>', '<link name="slider"></link>')
    text = text.replace('<link name="wheel"/>', '<link name="wheel"></link>')
    for link, visual in drawn.items():
        head = f'<link name="{link}">'
        text = text.replace(head, head + visual)
    file = tmp_path / "arm.urdf"
    file.write_text(text, encoding="utf-8")
    robot = RobotModel.from_urdf(file, "camera_optical_frame")
    joints = {"turn": 0.5 * math.pi, "slide": 0.2}
    solids = robot.solids_in("base", joints)
    seen = robot.visible_solids_in("base", joints)
    assert [solid.name for solid in seen[: len(solids)]] == [solid.name for solid in solids]
    beyond = {solid.name: solid for solid in seen[len(solids) :]}
    assert set(beyond) == {"slider", "upper"}
    cover = beyond["slider"]
    # The slider stands at y = 0.5 + 0.2, turned by 90 degrees: its x axis is the base's y.
    corner = cover.transform[:3, :3].T @ ((0.0, 1.7, 0.2) - cover.transform[:3, 3])
    assert abs(cover.solid.signed_distance(corner)) < 1e-6
    assert beyond["upper"].solid == Cylinder(0.08, 0.5)


def test_without_visual_shapes_nothing_more_is_seen() -> None:
    robot = RobotModel.from_urdf(ARM, "camera_optical_frame")
    assert len(robot.visible_solids_in("base", {"turn": 0.1, "slide": 0.1})) == len(robot.shapes)
