"""A base with a lift that carries two arms, of which the left one holds the camera; for tests."""

from __future__ import annotations

from infomap_ros.motion.robot.robot_model import RobotModel

CAMERA = "left_camera_optical_frame"
RIGHT = ("right_shoulder", "right_elbow")
HALF_BASE = 0.3
"""Half the length and the width of the base [m]."""

_BOX = """
    <inertial><mass value="{mass}"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <{kind}><origin xyz="{place}"/><geometry><box size="{size}"/></geometry></{kind}>
"""
_WHEEL = """
  <link name="{name}_wheel">
    <inertial><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin rpy="1.5707963 0 0"/>
      <geometry><cylinder radius="0.1" length="0.05"/></geometry></collision>
  </link>
  <joint name="{name}_wheel_joint" type="continuous">
    <parent link="base_link"/><child link="{name}_wheel"/>
    <origin xyz="{place}"/><axis xyz="0 1 0"/>
  </joint>
"""
_ARM = """
  <link name="{side}_upper">{upper}</link>
  <link name="{side}_lower">{lower}</link>
  <joint name="{side}_shoulder" type="revolute"><parent link="lift"/><child link="{side}_upper"/>
    <origin xyz="0.1 {y} {z}"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="50" velocity="1"/></joint>
  <joint name="{side}_elbow" type="revolute"><parent link="{side}_upper"/>
    <child link="{side}_lower"/><origin xyz="0.45 0 0.1"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="50" velocity="1"/></joint>
"""


def two_armed_urdf() -> str:
    """Both arms stretch 0.68 m beyond the base where their joints are at zero."""
    base = _BOX.format(kind="collision", mass=30, place="0 0 0.25", size="0.6 0.6 0.3")
    lift = _BOX.format(kind="collision", mass=5, place="0 0 0", size="0.2 0.3 0.1")
    part = _BOX.format(kind="collision", mass=1, place="0.2 0 0", size="0.45 0.06 0.06")
    wheels = [
        _WHEEL.format(name=f"{end}_{side}", place=f"{x} {y} 0.1")
        for end, x in (("front", 0.2), ("rear", -0.2))
        for side, y in (("left", 0.25), ("right", -0.25))
    ]
    arms = [
        _ARM.format(side=side, y=y, z=z, upper=part, lower=part)
        for side, y, z in (("left", 0.2, 0.4), ("right", -0.2, 0.12))
    ]
    return f"""<robot name="two_arms">
  <link name="base_link">{base}</link>
  <link name="lift">{lift}</link>
  <joint name="lift_joint" type="prismatic"><parent link="base_link"/><child link="lift"/>
    <origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.3" effort="500" velocity="0.1"/></joint>
  {"".join(wheels)}{"".join(arms)}
  <link name="{CAMERA}"/>
  <joint name="camera_mount" type="fixed"><parent link="left_lower"/><child link="{CAMERA}"/>
    <origin xyz="0.45 0 0" rpy="-1.5707963 0 -1.5707963"/></joint>
</robot>"""


def two_arms() -> RobotModel:
    """The robot; the left arm and the lift move its camera."""
    return RobotModel.from_urdf(two_armed_urdf(), CAMERA)
