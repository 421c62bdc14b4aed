"""Reading robot descriptions, and saying what is wrong with one.

The URDF parser below Pinocchio drops what it does not understand, a collision shape for example,
and only prints why. What is dropped from a body would be mapped as an obstacle, so the structure
is checked here first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from infomap_ros.errors import RobotModelError
from infomap_ros.motion.robot.mimicry import Follower, read_followers

_SHAPES = ("box", "cylinder", "sphere", "mesh")
_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")


@dataclass(frozen=True)
class RobotDescription:
    """A checked URDF.

    Attributes:
        xml: its text.
        folder: where the file lies, or None if it came as text.
        collision_shapes: number of ``<collision>`` elements.
        followers: joints that mimic another, by name.
    """

    xml: str
    folder: Path | None
    collision_shapes: int
    followers: Mapping[str, Follower]


def read_urdf(path_or_xml: str | Path, mimics: Mapping[str, str] | None = None) -> RobotDescription:
    """Read a URDF from a file, or take it as text, and check its structure.

    Args:
        path_or_xml: a path, or the XML itself (a string that starts with ``<``).
        mimics: joints that follow another without the URDF's saying so, name -> leader.

    Raises:
        RobotModelError: no such file, no XML, no tree of links, a joint or collision shape of an
            unknown type, or joints that cannot follow each other; names the culprit.
    """
    if isinstance(path_or_xml, str) and path_or_xml.lstrip().startswith("<"):
        return _checked(path_or_xml, None, mimics)
    path = Path(path_or_xml)
    try:
        xml = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RobotModelError(f"robot description {path}: {error.strerror}") from error
    except ValueError as error:
        raise RobotModelError(f"robot description {path} is not UTF-8 text") from error
    return _checked(xml, path.resolve().parent, mimics)


def _checked(xml: str, folder: Path | None, mimics: Mapping[str, str] | None) -> RobotDescription:
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError as error:
        raise RobotModelError(f"malformed URDF: {error}") from error
    if root.tag != "robot":
        raise RobotModelError(f"malformed URDF: the root element is <{root.tag}>, not <robot>")
    links = _unique_names(root, "link")
    _check_joints(root, links)
    shapes = sum(_check_collision(link) for link in root.findall("link"))
    return RobotDescription(xml, folder, shapes, read_followers(root, mimics))


def _unique_names(root: ElementTree.Element, tag: str) -> list[str]:
    names = [element.get("name", "") for element in root.findall(tag)]
    for name, count in Counter(names).items():
        if not name:
            raise RobotModelError(f"malformed URDF: a <{tag}> has no name")
        if count > 1:
            raise RobotModelError(f"malformed URDF: {count} {tag}s are named '{name}'")
    return names


def _check_joints(root: ElementTree.Element, links: list[str]) -> None:
    _unique_names(root, "joint")
    parents: dict[str, str] = {}
    for joint in root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind not in _JOINT_TYPES:
            raise RobotModelError(
                f"joint '{name}' has the type '{kind}', expected one of {', '.join(_JOINT_TYPES)}"
            )
        if kind in ("revolute", "prismatic") and joint.find("limit") is None:
            raise RobotModelError(f"joint '{name}' is {kind} and has no <limit>")
        parent, child = (_linked(joint, name, end, links) for end in ("parent", "child"))
        if child in parents:
            raise RobotModelError(f"link '{child}' is the child of two joints, one is '{name}'")
        parents[child] = parent
    _check_tree(links, parents)


def _linked(joint: ElementTree.Element, name: str, end: str, links: list[str]) -> str:
    element = joint.find(end)
    link = "" if element is None else element.get("link", "")
    if link not in links:
        raise RobotModelError(f"joint '{name}' has the unknown {end} link '{link}'")
    return link


def _check_tree(links: list[str], parents: dict[str, str]) -> None:
    roots = [link for link in links if link not in parents]
    if len(roots) > 1:
        raise RobotModelError(f"links {', '.join(map(repr, roots))} are not connected by joints")
    if not roots:
        raise RobotModelError("no link is the root: there are no links, or the joints form a loop")
    for link in links:
        seen = {link}
        while (link := parents.get(link, "")) and link not in seen:
            seen.add(link)
        if link:
            raise RobotModelError(f"the joints above link '{link}' form a loop")


def _check_collision(link: ElementTree.Element) -> int:
    shapes = link.findall("collision")
    for collision in shapes:
        geometry = collision.find("geometry")
        kinds = [] if geometry is None else [child.tag for child in geometry]
        if len(kinds) != 1 or kinds[0] not in _SHAPES:
            raise RobotModelError(
                f"link '{link.get('name')}' has a collision shape of {kinds or 'nothing'}, "
                f"expected one of {', '.join(_SHAPES)}"
            )
    return len(shapes)
