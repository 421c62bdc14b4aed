"""A robot description with what it lacks: an optical frame, or a base that drives.

Inertias that no body can have, and what they are replaced by.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import NamedTuple

import numpy as np

from infomap_ros.errors import ConfigError, RobotModelError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig

DEFAULT_CAMERA = "left_camera_optical_frame"
"""Name of a mounted camera's frame where `RobotSetupConfig.left_camera_frame` is empty."""
CART = "cart"
"""Name of the cart's link, and beginning of the names of its wheels."""
CART_WHEELS = (f"{CART}_left_wheel_joint",), (f"{CART}_right_wheel_joint",)
"""Joints of the cart's driven wheels, left and right."""
CART_CASTERS = tuple(
    f"{CART}_{end}_{side}_caster" for end in ("front", "rear") for side in ("left", "right")
)
"""Links of the cart's casters."""

_NOT_LINKS = ("world", "map", "odom")  # MuJoCo's own body is called world
_WHEEL_RADIUS, _WHEEL_WIDTH, _CASTER_RADIUS = 0.1, 0.04, 0.06  # [m]
_CLEARANCE = 0.12  # of the box above the ground, more than two voxels [m]
_CASTER_LIFT = 0.001  # so that the wheels carry most of the weight [m]
_DENSITY = 300.0  # of the box, batteries and electronics within sheet metal [kg/m^3]
_WHEEL_MASS, _CASTER_MASS = 1.0, 0.2  # [kg]


def extended_description(description: str, setup: RobotSetupConfig) -> str:
    """Add the camera of `camera_mount` and the `cart` to a URDF; the same text without either.

    Args:
        description: URDF text.
        setup: of the robot.

    Raises:
        RobotModelError: it is not XML.
        ConfigError: a link of the setup is not there, or the frame to be added is.
    """
    if not setup.camera_mount and not setup.cart:
        return description
    try:
        tree = ElementTree.fromstring(description)
    except ElementTree.ParseError as error:
        raise RobotModelError(f"robot description: {error}") from error
    if setup.cart:
        _add_cart(tree, setup)
    if setup.camera_mount:
        _add_camera(tree, setup)
    return ElementTree.tostring(tree, encoding="unicode")


def root_link(tree: ElementTree.Element) -> str:
    """The link that no joint carries; a frame of the surroundings is none of the robot's.

    Args:
        tree: ``<robot>``.

    Raises:
        RobotModelError: there is none.
    """
    parents = {_end(joint, "child"): joint for joint in tree.findall("joint")}
    roots = [link.get("name", "") for link in tree.findall("link")]
    root = next((name for name in roots if name not in parents), None)
    if root is None:
        undeclared = sorted({_end(j, "parent") for j in tree.findall("joint")} - set(roots))
        why = f"'{undeclared[0]}' is none" if undeclared else "joints form a loop, or there is none"
        raise RobotModelError(f"robot description: no link is the root: {why}")
    below = [joint for joint in tree.findall("joint") if _end(joint, "parent") == root]
    if root in _NOT_LINKS and len(below) == 1 and below[0].get("type") == "fixed":
        return _end(below[0], "child")
    return root


def _add_camera(tree: ElementTree.Element, setup: RobotSetupConfig) -> None:
    link, (x, y, z, roll, pitch, yaw) = setup.mounted_camera
    names = [each.get("name") for each in tree.findall("link")]
    frame = setup.left_camera_frame or DEFAULT_CAMERA
    if link not in names:
        raise ConfigError("robot.camera_mount", setup.camera_mount, "a link of the description")
    if frame in names:
        expected = f"empty, as the description has '{frame}'"
        raise ConfigError("robot.camera_mount", setup.camera_mount, expected)
    ElementTree.SubElement(tree, "link", name=frame)
    _fix(tree, link, frame, f"{x} {y} {z}", f"{roll} {pitch} {yaw}")


def _add_cart(tree: ElementTree.Element, setup: RobotSetupConfig) -> None:
    length, width, height = setup.cart
    root = root_link(tree)
    for joint in tree.findall("joint"):
        if _end(joint, "child") == root:
            surroundings = _end(joint, "parent")
            tree.remove(joint)
            tree.remove(next(k for k in tree.findall("link") if k.get("name") == surroundings))
    base = root
    if height > 0.0:
        base, middle = CART, _CLEARANCE + 0.5 * height
        size, mass = (length, width, height), _DENSITY * length * width * height
        x, y, z = (side * side for side in size)
        inertia = tuple(mass / 12.0 * two for two in (y + z, x + z, x + y))
        box = f'<box size="{length:g} {width:g} {height:g}"/>'
        _add_link(tree, CART, box, mass, inertia, f"0 0 {middle:g}")
        _fix(tree, CART, root, f"0 0 {_CLEARANCE + height:g}")
    for side, joints in zip((1.0, -1.0), CART_WHEELS, strict=True):
        wheel = joints[0].removesuffix("_joint")
        shape = f'<cylinder radius="{_WHEEL_RADIUS}" length="{_WHEEL_WIDTH}"/>'
        across = _WHEEL_MASS * (3.0 * _WHEEL_RADIUS**2 + _WHEEL_WIDTH**2) / 12.0
        inertia = (across, across, 0.5 * _WHEEL_MASS * _WHEEL_RADIUS**2)
        _add_link(tree, wheel, shape, _WHEEL_MASS, inertia)
        y = side * 0.5 * (width - _WHEEL_WIDTH)
        place, turn = f"0 {y:g} {_WHEEL_RADIUS}", "-1.570796327 0 0"
        joint = _join(tree, joints[0], "continuous", base, wheel, place, turn)
        ElementTree.SubElement(joint, "axis", xyz="0 0 1")
    for number, caster in enumerate(CART_CASTERS):
        x = (1.0 if number < 2 else -1.0) * (0.5 * length - _CASTER_RADIUS)
        y = (-1.0 if number % 2 else 1.0) * (0.5 * width - _CASTER_RADIUS)
        inertia = (0.4 * _CASTER_MASS * _CASTER_RADIUS**2,) * 3
        ball = f'<sphere radius="{_CASTER_RADIUS}"/>'
        _add_link(tree, caster, ball, _CASTER_MASS, inertia)
        _fix(tree, base, caster, f"{x:g} {y:g} {_CASTER_RADIUS + _CASTER_LIFT:g}")


def _add_link(
    tree: ElementTree.Element,
    name: str,
    shape: str,
    mass: float,
    inertia: tuple[float, ...],
    place: str = "0 0 0",
) -> None:
    """A link of one solid; inertia about its main axes, through the solid's middle [kg m^2]."""
    link = ElementTree.SubElement(tree, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=place)
    ElementTree.SubElement(inertial, "mass", value=f"{mass:.6g}")
    moments = dict(zip(("ixx", "iyy", "izz"), (f"{one:.6g}" for one in inertia), strict=True))
    ElementTree.SubElement(inertial, "inertia", {**moments, "ixy": "0", "ixz": "0", "iyz": "0"})
    for kind in ("visual", "collision"):
        part = ElementTree.SubElement(link, kind)
        ElementTree.SubElement(part, "origin", xyz=place)
        ElementTree.SubElement(part, "geometry").append(ElementTree.fromstring(shape))


def _fix(tree: ElementTree.Element, parent: str, child: str, xyz: str, rpy: str = "0 0 0") -> None:
    _join(tree, f"{child}_mount", "fixed", parent, child, xyz, rpy)


def _join(
    tree: ElementTree.Element, name: str, kind: str, parent: str, child: str, xyz: str, rpy: str
) -> ElementTree.Element:
    joint = ElementTree.SubElement(tree, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    return joint


def _end(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


_KEYS = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
_TOLERANCE = 1e-6  # share of the largest moment by which the sum of the others must exceed it
_LEAST_SHARE = 1e-3  # of the largest moment that the smallest one is given
_LEAST_MASS = 0.01  # of a link that moves and has none [kg]
_LEAST_RADIUS = 0.01  # of the ball that such a link is taken for [m]


class MendedInertia(NamedTuple):
    """An inertia that was replaced.

    Attributes:
        link: whose.
        problem: what was wrong, and what was done.
    """

    link: str
    problem: str


def mend_inertias(robot: ElementTree.Element) -> list[MendedInertia]:
    """Replace inertias that no body can have by the nearest that one can, in place.

    Main moments a <= b <= c must be positive with a + b >= c; where c is larger, a and b grow by
    the same. Those of a flat body, a + b = c, grow by a millionth unsaid: rounding may refuse them.

    A link that a joint moves, and that has no mass together with all that is fixed to
    it, becomes a ball of 10 g.

    Args:
        robot: root of the URDF; changed.

    Raises:
        RobotModelError: an inertia has no number where one must be.
    """
    mended = []
    for link in robot.findall("link"):
        element = link.find("inertial/inertia")
        if element is None:
            continue
        problem = _mend(element, link.get("name", ""))
        if problem:
            mended.append(MendedInertia(link.get("name", ""), problem))
    for name in _moving_without_mass(robot):
        link = next(each for each in robot.findall("link") if each.get("name") == name)
        for old in link.findall("inertial"):
            link.remove(old)
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "mass", value=str(_LEAST_MASS))
        moment = f"{0.4 * _LEAST_MASS * _LEAST_RADIUS**2:.3g}"
        moments = dict.fromkeys(("ixx", "iyy", "izz"), moment)
        ElementTree.SubElement(inertial, "inertia", {**moments, "ixy": "0", "ixz": "0", "iyz": "0"})
        mended.append(MendedInertia(name, "moves and has no mass; 10 g are assumed"))
    return mended


def _mend(element: ElementTree.Element, link: str) -> str:
    try:
        matrix = np.array([[float(element.get(key, "0")) for key in row] for row in _KEYS])
    except ValueError as error:
        raise RobotModelError(f"link '{link}' has a malformed inertia: {error}") from error
    if not np.isfinite(matrix).all():
        raise RobotModelError(f"link '{link}' has an inertia that is not finite")
    moments, axes = np.linalg.eigh(matrix)
    if not matrix.any():
        return ""  # as of a frame; counted as no mass
    possible = _possible(moments)
    if np.array_equal(possible, moments):
        return ""
    repaired = axes @ np.diag(possible) @ axes.T
    for row, keys in enumerate(_KEYS):
        for column, key in enumerate(keys):
            element.set(key, repr(float(repaired[row, column])))
    if np.allclose(possible, moments, rtol=0.0, atol=2.0 * _TOLERANCE * abs(moments).max()):
        return ""
    numbers = ", ".join(f"{moment:.3g}" for moment in moments)
    return (
        f"main moments {numbers} kg m^2 are those of no body; "
        + ", ".join(f"{moment:.3g}" for moment in possible)
        + " are taken"
    )


def _possible(moments: FloatArray) -> FloatArray:
    """Moments of a body near given ones, ascending, shape (3,)."""
    largest = float(np.abs(moments).max())
    possible = np.maximum(moments, _LEAST_SHARE * largest)
    lacking = possible[2] - possible[0] - possible[1]
    if lacking > -_TOLERANCE * largest:
        possible[:2] += 0.5 * ((1.0 + _LEAST_SHARE) * max(lacking, 0.0) + _TOLERANCE * largest)
    return np.asarray(possible)


def _moving_without_mass(robot: ElementTree.Element) -> list[str]:
    """Links that a joint moves and that have no mass with all that is fixed to them."""
    fixed: dict[str, list[str]] = {}
    moved = []
    for joint in robot.findall("joint"):
        ends = [joint.find(end) for end in ("parent", "child")]
        parent, child = ("" if end is None else end.get("link", "") for end in ends)
        if joint.get("type") == "fixed":
            fixed.setdefault(parent, []).append(child)
        else:
            moved.append(child)
    heavy = {link.get("name", "") for link in robot.findall("link") if _has_mass(link)}

    def carries_mass(link: str) -> bool:
        return link in heavy or any(carries_mass(child) for child in fixed.get(link, []))

    return [link for link in moved if not carries_mass(link)]


def _has_mass(link: ElementTree.Element) -> bool:
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    if mass is None or inertia is None:
        return False
    moments = [float(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz")]
    return float(mass.get("value", "0")) > 0.0 and min(moments) > 0.0
