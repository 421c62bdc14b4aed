"""Which links of a robot could touch each other without being meant to."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pinocchio
from numpy.typing import NDArray

from infomap_ros.motion.link_tree import LinkTree
from infomap_ros.motion.robot_model import RobotModel


def movable_pairs(robot: RobotModel, tree: LinkTree) -> NDArray[np.int64]:
    """Pairs of links with shapes that move against each other and are not joined by a joint.

    Two links count as joined where only links without shapes are between them.

    Returns:
        Numbers in ``robot.links_with_solids``, shape (P, 2).
    """
    links = robot.links_with_solids
    joint_of = {shape.link: shape.joint for shape in robot.shapes}
    above = {link: _next_above(robot, link) for link in links}
    pairs = [
        (i, j)
        for (i, a), (j, b) in combinations(enumerate(links), 2)
        if tree.bodies[joint_of[a]] != tree.bodies[joint_of[b]] and above[a] != b and above[b] != a
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _next_above(robot: RobotModel, link: str) -> str:
    """The nearest link with shapes on the way to the root, or empty."""
    parent = _link_above(robot, link)
    while parent and parent not in robot.links_with_solids:
        parent = _link_above(robot, parent)
    return parent


def _link_above(robot: RobotModel, link: str) -> str:
    """The parent link, empty for the root."""
    frames = robot.model.frames
    own = frames[robot.model.getFrameId(link, pinocchio.FrameType.BODY)]
    above = frames[frames[own.parentFrame].parentFrame]
    return str(above.name) if above.type == pinocchio.FrameType.BODY else ""
