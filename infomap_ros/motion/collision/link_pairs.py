"""Which links of a robot could touch each other without being meant to."""

from __future__ import annotations

import fnmatch
from itertools import combinations

import numpy as np
import pinocchio
from numpy.typing import NDArray

from infomap_ros.motion.robot.link_tree import LinkTree
from infomap_ros.motion.robot.robot_model import RobotModel


def movable_pairs(robot: RobotModel, tree: LinkTree) -> NDArray[np.int64]:
    """Pairs of links with shapes that move against each other and are not joined by a joint.

    Two links count as joined where only links without shapes are between them, and where all
    joints between them slide in one direction, as the tubes of a telescope do: these are in one
    another by design.

    Returns:
        Numbers in ``robot.links_with_solids``, shape (P, 2).
    """
    links = robot.links_with_solids
    joint_of = {shape.link: shape.joint for shape in robot.shapes}
    above = {link: _next_above(robot, link) for link in links}
    pairs = [
        (i, j)
        for (i, a), (j, b) in combinations(enumerate(links), 2)
        if above[a] != b
        and above[b] != a
        and not _is_telescope(tree, int(tree.bodies[joint_of[a]]), int(tree.bodies[joint_of[b]]))
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def allowed_pairs(
    links: tuple[str, ...], pairs: NDArray[np.int64], contacts: tuple[str, ...]
) -> NDArray[np.bool_]:
    """Tell which pairs of links, shape (P, 2), are allowed to touch, shape (P,).

    Args:
        links: names.
        pairs: numbers of links.
        contacts: pairs of patterns, as ``first:second``, in either order.
    """
    patterns = [contact.split(":") for contact in contacts]
    patterns += [[second, first] for first, second in patterns]
    allowed = [
        any(
            fnmatch.fnmatchcase(links[i], a) and fnmatch.fnmatchcase(links[j], b)
            for a, b in patterns
        )
        for i, j in pairs
    ]
    return np.array(allowed, dtype=bool)


def is_any_of(link: str, patterns: tuple[str, ...]) -> bool:
    """Whether a link's name matches a pattern."""
    return any(fnmatch.fnmatchcase(link, pattern) for pattern in patterns)


def _is_telescope(tree: LinkTree, first: int, second: int) -> bool:
    """Whether all joints between two bodies slide in one direction; also where there is none."""
    up, down = set(tree.bodies_up_from(first)), set(tree.bodies_up_from(second))
    joints = [body - 1 for body in up ^ down]
    axes = np.array([tree.axis(joint) for joint in joints]).reshape(-1, 3)
    parallel = np.abs(axes @ axes[:1].T) > 1.0 - 1e-6
    return bool(tree.arrays.prismatic[joints].all() and parallel.all())


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
