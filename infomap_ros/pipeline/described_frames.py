"""Frames that a robot's description does not have, put into it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Mapping

from scipy.spatial.transform import Rotation

from infomap_ros.geometry import TransformRecord


def with_prefix(description: str, prefix: str) -> str:
    """A URDF whose links are called as robot_state_publisher calls their frames.

    Args:
        description: text of the URDF; returned as it is where it cannot be read.
        prefix: put before the name of each link.
    """
    root = _read(description) if prefix else None
    if root is None:
        return description
    for link in root.iter("link"):
        link.set("name", prefix + link.get("name", ""))
    for end in (*root.iterfind("joint/parent"), *root.iterfind("joint/child")):
        end.set("link", prefix + end.get("link", ""))
    return ET.tostring(root, encoding="unicode")


def links_of(description: str) -> frozenset[str]:
    """Names of the links of a URDF; none where it cannot be read."""
    root = _read(description)
    links = () if root is None else root.iterfind("link")
    return frozenset(link.get("name", "") for link in links)


def fixed_chains(
    edges: Mapping[str, TransformRecord], wanted: Iterable[str], links: Collection[str]
) -> list[TransformRecord]:
    """The fixed transforms from links of a robot down to frames, where they lead there.

    Args:
        edges: fixed transforms, each by its child frame.
        wanted: the frames.
        links: names of the robot's links.
    """
    return [edge for frame in wanted for edge in _chain(frame, edges, links)]


def with_fixed_frames(description: str, chains: Iterable[TransformRecord]) -> str:
    """A URDF with links at frames that only tf tells, such as a camera's optical frame.

    Args:
        description: text of the URDF; returned as it is where it cannot be read or lacks nothing.
        chains: of `fixed_chains`.
    """
    added = {edge.child_frame_id: edge for edge in chains}
    root = _read(description) if added else None
    if root is None:
        return description
    for edge in added.values():
        _attach(root, edge)
    return ET.tostring(root, encoding="unicode")


def _read(description: str) -> ET.Element | None:
    """The URDF; None where it is none, which is for its reader to say."""
    try:
        return ET.fromstring(description)
    except ET.ParseError:
        return None


def _chain(
    frame: str, edges: Mapping[str, TransformRecord], links: Collection[str]
) -> list[TransformRecord]:
    """The transforms from a link down to a frame, none where there is no such way."""
    chain: list[TransformRecord] = []
    while frame not in links:
        edge = edges.get(frame)
        if edge is None or len(chain) > len(edges):
            return []
        chain.append(edge)
        frame = edge.frame_id
    return chain[::-1]


def _attach(root: ET.Element, edge: TransformRecord) -> None:
    """Add a link that is fixed to another."""
    ET.SubElement(root, "link", name=edge.child_frame_id)
    joint = ET.SubElement(root, "joint", name=f"{edge.child_frame_id}_by_tf", type="fixed")
    ET.SubElement(joint, "parent", link=edge.frame_id)
    ET.SubElement(joint, "child", link=edge.child_frame_id)
    angles = Rotation.from_matrix(edge.transform[:3, :3]).as_euler("xyz")
    values = {"xyz": edge.transform[:3, 3], "rpy": angles}
    texts = {name: " ".join(repr(float(each)) for each in value) for name, value in values.items()}
    ET.SubElement(joint, "origin", texts)
