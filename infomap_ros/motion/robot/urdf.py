"""Reading robot descriptions, and saying what is wrong with one.

The URDF parser below Pinocchio drops what it does not understand, a collision shape for example,
and only prints why. What is dropped from a body would be mapped as an obstacle, so the structure
is checked here first. That parser also follows a tree of links by recursion, and a description may
come from a stranger, so its size is bounded before anything else reads it.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
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


_SHAPES = ("box", "cylinder", "sphere", "mesh")
_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")

MOST_BYTES = 4_000_000
"""Of a description, as UTF-8; the largest in the field, with inline visuals, hold about 1 MB."""

MOST_LINKS = 1000
"""About five times those of a humanoid with hands; they are read within a second."""

MOST_DEPTH = 256
"""Links from the root to a tip: urdfdom and Pinocchio recurse, 2,000 fit into a usual stack."""

MOST_SHAPES = 1000
"""Collision shapes of all links."""

FARTHEST = 1000.0
"""Of the origin of a joint or shape in its link [m]; so nothing overflows on the way to a tip."""

_MOST_ELEMENTS = 100_000
_MOST_PREFIXES = 50
_MOST_NESTING = 64  # of elements; URDF needs six, simulators' extensions a few more


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
            unknown type, an origin that is none, joints that cannot follow each other, or more of
            anything than the limits of this module; names the culprit.
    """
    if isinstance(path_or_xml, str) and path_or_xml.lstrip().startswith("<"):
        return _checked(path_or_xml, None, mimics)
    path = Path(path_or_xml)
    try:
        with path.open("rb") as file:
            xml = file.read(MOST_BYTES + 1).decode("utf-8")
    except OSError as error:
        raise RobotModelError(f"robot description {path}: {error.strerror}") from error
    except ValueError as error:
        raise RobotModelError(f"robot description {path} is not UTF-8 text") from error
    return _checked(xml, path.resolve().parent, mimics)


def hash_of_description(text: str) -> str:
    """SHA-256 of a robot_description in UTF-8, as 64 hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def _checked(xml: str, folder: Path | None, mimics: Mapping[str, str] | None) -> RobotDescription:
    try:
        _check_number("bytes", len(xml.encode("utf-8")), MOST_BYTES)
        xml = _with_plain_names(xml)
        parser = ElementTree.XMLParser(target=_BoundedTree())
        parser.feed(xml)
        root = parser.close()
    except (ElementTree.ParseError, UnicodeEncodeError) as error:
        raise RobotModelError(f"malformed URDF: {error}") from error
    if root.tag != "robot":
        raise RobotModelError(f"malformed URDF: the root element is <{root.tag}>, not <robot>")
    links = _unique_names(root, "link")
    _check_number("links", len(links), MOST_LINKS)
    _check_joints(root, links)
    shapes = sum(_check_collision(link) for link in root.findall("link"))
    _check_number("collision shapes", shapes, MOST_SHAPES)
    for origin in root.iter("origin"):
        _check_origin(origin)
    return RobotDescription(xml, folder, shapes, read_followers(root, mimics))


def _with_plain_names(xml: str) -> str:
    """XML without the prefixes of names that nothing declares, which ROS's parser does not mind.

    Extensions of simulators have them: ``<sensor:camera>``.
    """
    declared = {*re.findall(r"\bxmlns:([\w.-]+)\s*=", xml), "xml", "xmlns"}
    prefixes = {*re.findall(r"</?([\w.-]+):", xml), *re.findall(r"\s([\w.-]+):[\w.-]+\s*=", xml)}
    for prefix in prefixes - declared if len(prefixes) < _MOST_PREFIXES else ():
        xml = re.sub(rf"(</?|\s){re.escape(prefix)}:(?=[\w.-]+[\s=/>])", r"\1", xml)
    return xml


class _BoundedTree(ElementTree.TreeBuilder):
    """Builds a tree of elements until it is larger than a description can be."""

    def __init__(self) -> None:
        super().__init__()
        self._count = self._depth = 0

    def start(self, tag: str, attributes: dict[str, str]) -> ElementTree.Element:
        self._count, self._depth = self._count + 1, self._depth + 1
        _check_number("elements", self._count, _MOST_ELEMENTS)
        _check_number("elements within each other", self._depth, _MOST_NESTING)
        return super().start(tag, attributes)

    def end(self, tag: str) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)


def _check_number(what: str, number: int, most: int) -> None:
    if number > most:
        raise RobotModelError(f"robot description has {number} {what}, at most {most} are read")


def _check_origin(origin: ElementTree.Element) -> None:
    for key, most in (("xyz", FARTHEST), ("rpy", math.inf)):
        text = origin.get(key, "0 0 0")
        try:
            numbers = [float(number) for number in text.split()]
        except ValueError:
            numbers = []
        if len(numbers) != 3 or not all(math.isfinite(n) and abs(n) <= most for n in numbers):
            raise RobotModelError(f"an <origin> has {key}='{text[:60]}', expected three numbers")


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
        _check_limit(name, kind, joint.find("limit"))
        parent, child = (_linked(joint, name, end, links) for end in ("parent", "child"))
        if child in parents:
            raise RobotModelError(f"link '{child}' is the child of two joints, one is '{name}'")
        parents[child] = parent
    _check_tree(links, parents)


def _check_limit(joint: str, kind: str, limit: ElementTree.Element | None) -> None:
    if limit is None:
        if kind in ("revolute", "prismatic"):
            raise RobotModelError(f"joint '{joint}' is {kind} and has no <limit>")
        return
    for key in ("effort", "velocity"):
        text = limit.get(key)
        if kind != "fixed" and (text is None or not _is_number(text, low=0.0)):
            problem = f"no {key}" if text is None else f"{key}='{text[:60]}', expected at least 0"
            raise RobotModelError(f"the <limit> of joint '{joint}' has {problem}")


def _is_number(text: str, low: float) -> bool:
    try:
        return float(text) >= low
    except ValueError:
        return False


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
        _check_number("links in a row", len(seen), MOST_DEPTH)


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
