"""Inertias that no body can have, and what they are replaced by."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import NamedTuple

import numpy as np

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.transforms import FloatArray

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
