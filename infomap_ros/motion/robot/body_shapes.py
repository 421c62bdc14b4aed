"""Collision shapes of a URDF as the solids of `geometry`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio

from infomap_ros.errors import InvalidInputError, RobotModelError
from infomap_ros.geometry import Box, ConvexPolytope, Cylinder, Solid, Sphere
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.urdf import RobotDescription

PLATE_THICKNESS = 0.001
"""What a mesh without a volume, such as a printed tag, is given [m]."""

LARGEST = 100.0
"""Radius of the sphere that holds a collision shape [m]: larger ones are no part of a robot."""

_FLAT = 1e-6  # smallest share of its largest extent at which a mesh has a volume
_STICKS_OUT = 0.01  # [m]; what is seen of a link no farther out than this is held by its solids
_COMPARED = 5000  # vertices of a mesh by which that is told
_SAME_PLANE = 1e-7  # facets of a hull whose normals [1] and offsets [m] agree so far are one


@dataclass(frozen=True, eq=False)
class BodyShape:
    """One collision shape of a link.

    Attributes:
        link: name of the link.
        joint: index of the joint that moves it, 0 for none.
        solid: the shape.
        placement: ``T_joint_solid``, shape (4, 4).
        geometry: the shape as coal has it, a mesh with its hollows.
    """

    link: str
    joint: int
    solid: Solid
    placement: FloatArray
    geometry: coal.CollisionGeometry

    @property
    def vertices(self) -> FloatArray | None:
        """Of a mesh, in the frame of `solid`, shape (V, 3) [m]; None for a plain shape."""
        if not hasattr(self.geometry, "vertices"):
            return None
        return np.asarray(self.geometry.vertices(), dtype=np.float64).reshape(-1, 3)


class Shapes(NamedTuple):
    """Shapes of a robot.

    Attributes:
        found: those that can be used.
        missing: meshes that this computer does not have, in sentences.
        empty: shapes without a size, in sentences.
    """

    found: tuple[BodyShape, ...]
    missing: tuple[str, ...]
    empty: tuple[str, ...]


def body_shapes(
    model: pinocchio.Model, description: RobotDescription, package_folders: Sequence[str | Path]
) -> Shapes:
    """Build the collision shapes of all links; a mesh becomes its convex hull.

    Meshes that this computer does not have, and shapes without a size, are left out.

    Args:
        model: made from the same description.
        description: the URDF.
        package_folders: where ``package://name/...`` and relative mesh files are looked for,
            besides the description's own folder, ROS_PACKAGE_PATH and AMENT_PREFIX_PATH.

    Raises:
        RobotModelError: dimensions cannot be read or are beyond `LARGEST`.
    """
    folders = _folders(description, package_folders)
    items, missing = _geometry(model, description.xml, "collision", folders)
    if len(items) + len(missing) != description.collision_shapes:
        raise RobotModelError(
            f"only {len(items)} of {description.collision_shapes} collision shapes can be read: "
            "check their dimensions and origins"
        )
    found, empty = [], []
    for item in items:
        try:
            found.append(_shape(model, item))
        except InvalidInputError as error:
            link = str(model.frames[item.parentFrame].name)
            empty.append(f"link '{link}' has an impossible shape: {error}")
    return Shapes(tuple(found), tuple(missing), tuple(empty))


def _folders(description: RobotDescription, package_folders: Sequence[str | Path]) -> list[str]:
    own = [] if description.folder is None else [description.folder]
    return [str(folder) for folder in (*package_folders, *own)]


def visible_shapes(
    model: pinocchio.Model,
    description: RobotDescription,
    package_folders: Sequence[str | Path],
    solids: Sequence[BodyShape],
) -> tuple[BodyShape, ...]:
    """What a camera sees of a robot beyond its collision shapes: covers, cables, simplified links.

    The visual shapes that stick out of the collision shapes of the same link by more than 1 cm,
    or whose link has none; a mesh becomes its convex hull. Meshes that cannot be read are left out.

    Args:
        model: made from the same description.
        description: the URDF.
        package_folders: as for `body_shapes`.
        solids: collision shapes of the robot.
    """
    try:
        items, _ = _geometry(
            model, description.xml, "visual", _folders(description, package_folders)
        )
    except RobotModelError:
        return ()
    found = []
    for item in items:
        try:
            shape = _shape(model, item)
        except (InvalidInputError, RobotModelError):
            continue
        if _sticks_out(shape, [solid for solid in solids if solid.link == shape.link]):
            found.append(shape)
    return tuple(found)


def _geometry(
    model: pinocchio.Model, xml: str, tag: str, folders: list[str]
) -> tuple[list[pinocchio.GeometryObject], list[str]]:
    """The shapes of all links, and what is left out as its mesh cannot be read."""
    try:
        return _built(model, xml, tag, folders), []
    except (ValueError, RuntimeError) as error:
        root, missing = ElementTree.fromstring(xml), []
        problems: dict[str, str] = {}  # by file, so that each is tried once
        for link in root.findall("link"):
            for part in link.findall(tag):
                mesh = part.find("geometry/mesh")
                file = "" if mesh is None else mesh.get("filename", "")
                if file not in problems:
                    problems[file] = _why_not(file, tag, folders) if file else ""
                if problems[file]:
                    link.remove(part)
                    missing.append(f"link '{link.get('name')}': {problems[file]}")
        if not missing:
            raise RobotModelError(f"{tag} shapes: {error}") from error
    text = ElementTree.tostring(root, encoding="unicode")
    try:
        return _built(model, text, tag, folders), missing
    except (ValueError, RuntimeError) as error:
        raise RobotModelError(f"{tag} shapes: {error}") from error


def _built(
    model: pinocchio.Model, xml: str, tag: str, folders: list[str]
) -> list[pinocchio.GeometryObject]:
    kind = pinocchio.GeometryType.VISUAL if tag == "visual" else pinocchio.GeometryType.COLLISION
    built = pinocchio.buildGeomFromUrdfString(model, xml, kind, package_dirs=folders)
    return list(built.geometryObjects)


def _why_not(file: str, tag: str, folders: list[str]) -> str:
    """Why a mesh cannot be read, asked of a robot that has nothing else; empty where it can."""
    robot = ElementTree.Element("robot", name="mesh")
    part = ElementTree.SubElement(ElementTree.SubElement(robot, "link", name="link"), tag)
    ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), "mesh", filename=file)
    text = ElementTree.tostring(robot, encoding="unicode")
    try:
        _built(pinocchio.buildModelFromXML(text), text, tag, folders)
    except (ValueError, RuntimeError) as error:
        return str(error)
    return ""


def _sticks_out(shape: BodyShape, solids: Sequence[BodyShape]) -> bool:
    """Whether a shape has points farther than `_STICKS_OUT` from all solids of its link."""
    if not solids:
        return True
    points = _outline(shape) @ shape.placement[:3, :3].T + shape.placement[:3, 3]
    away = np.full(len(points), np.inf)
    for solid in solids:
        local = (points - solid.placement[:3, 3]) @ solid.placement[:3, :3]
        away = np.minimum(away, solid.solid.signed_distance(local))
    return bool(away.max() > _STICKS_OUT)


def _outline(shape: BodyShape) -> FloatArray:
    """Points on the surface of a shape, in the frame of `solid`, shape (N, 3) [m]."""
    solid, vertices = shape.solid, shape.vertices
    if vertices is not None:
        return vertices[:: max(1, len(vertices) // _COMPARED)]
    if isinstance(solid, Box):
        return 0.5 * np.array(list(product(*[(-edge, edge) for edge in solid.size])))
    angles = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(16)])
    if isinstance(solid, Cylinder):
        ends = [(0.0, 0.0, end * 0.5 * solid.length) for end in (-1.0, 1.0)]
        return np.concatenate([solid.radius * ring + end for end in ends])
    turned = [np.roll(ring, axis, axis=1) for axis in range(3)]
    return solid.bounding_radius * np.concatenate(turned)


def _shape(model: pinocchio.Model, item: pinocchio.GeometryObject) -> BodyShape:
    link, solid = str(model.frames[item.parentFrame].name), _solid(item.geometry)
    if not solid.bounding_radius <= LARGEST:
        text = f"link '{link}' has a collision shape of radius {solid.bounding_radius:g} m"
        raise RobotModelError(f"{text}, at most {LARGEST:g} m are read")
    return BodyShape(
        link, int(item.parentJoint), solid, np.array(item.placement.homogeneous), item.geometry
    )


def _solid(geometry: coal.CollisionGeometry) -> Solid:
    if isinstance(geometry, coal.Box):
        x, y, z = 2.0 * np.asarray(geometry.halfSide).ravel()
        return Box((float(x), float(y), float(z)))
    if isinstance(geometry, coal.Cylinder):
        return Cylinder(float(geometry.radius), 2.0 * float(geometry.halfLength))
    if isinstance(geometry, coal.Sphere):
        return Sphere(float(geometry.radius))
    return _hull(np.asarray(geometry.vertices(), dtype=np.float64).reshape(-1, 3))


def _hull(vertices: FloatArray) -> ConvexPolytope:
    """Convex hull with the coplanar triangles of a facet counted once; a flat mesh is a plate."""
    if len(vertices) < 3:
        raise InvalidInputError("mesh", f"has {len(vertices)} vertices")
    centered = vertices - vertices.mean(axis=0)
    _, extents, directions = np.linalg.svd(centered, full_matrices=False)
    if extents[2] < _FLAT * extents[0]:
        half = 0.5 * PLATE_THICKNESS * directions[2]
        vertices = np.concatenate([vertices - half, vertices + half])
    hull = ConvexPolytope.from_points(vertices)
    planes = np.column_stack([hull.normals, hull.offsets])
    _, first = np.unique(np.round(planes / _SAME_PLANE), axis=0, return_index=True)
    return ConvexPolytope(hull.normals[first], hull.offsets[first], hull.radius)
