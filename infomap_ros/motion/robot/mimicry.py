"""Joints that follow another one, by ``<mimic>`` in a URDF or because the user knows it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

from infomap_ros.errors import RobotModelError


@dataclass(frozen=True)
class Follower:
    """A joint at ``factor * position + offset``, the position being that of another joint.

    Attributes:
        leader: name of the other joint, which follows none.
        factor: multiplier.
        offset: [rad or m].
    """

    leader: str
    factor: float = 1.0
    offset: float = 0.0


def read_followers(
    root: ElementTree.Element, mimics: Mapping[str, str] | None = None
) -> dict[str, Follower]:
    """Find the joints that follow others; one that follows a follower gets the first leader.

    Args:
        root: ``<robot>``, with joints of unique names.
        mimics: joints that follow another without the URDF's saying so: name -> leader.

    Returns:
        By name of the joint. Fixed joints follow none.

    Raises:
        RobotModelError: a leader or a joint of `mimics` does not exist or is fixed, joints follow
            each other in a loop, or a number is none.
    """
    moving = {
        joint.get("name", ""): joint
        for joint in root.findall("joint")
        if joint.get("type") != "fixed"
    }
    direct = {
        name: _follower(name, element)
        for name, joint in moving.items()
        if (element := joint.find("mimic")) is not None
    }
    for name, leader in (mimics or {}).items():
        if name not in moving:
            raise RobotModelError(f"the robot has no moving joint '{name}' that could mimic one")
        direct[name] = Follower(leader)
    return {name: _resolved(name, direct, moving) for name in direct}


def _follower(name: str, element: ElementTree.Element) -> Follower:
    try:
        factor, offset = (
            float(element.get(key, default))
            for key, default in (("multiplier", "1"), ("offset", "0"))
        )
    except ValueError as error:
        raise RobotModelError(f"joint '{name}' has a malformed <mimic>: {error}") from error
    if not (math.isfinite(factor) and math.isfinite(offset)):
        raise RobotModelError(f"joint '{name}' has a <mimic> that is not finite")
    return Follower(element.get("joint", ""), factor, offset)


def _resolved(name: str, direct: Mapping[str, Follower], moving: Mapping[str, object]) -> Follower:
    """The follower with its first leader, through all followers between them."""
    seen, leader, factor, offset = {name}, name, 1.0, 0.0
    while leader in direct:
        step = direct[leader]
        if step.leader not in moving:
            raise RobotModelError(
                f"joint '{leader}' mimics '{step.leader}', which is no moving joint of the robot"
            )
        offset, factor = offset + factor * step.offset, factor * step.factor
        leader = step.leader
        if leader in seen:
            raise RobotModelError(f"joints {', '.join(sorted(seen))} mimic each other in a loop")
        seen.add(leader)
    return Follower(leader, factor, offset)
