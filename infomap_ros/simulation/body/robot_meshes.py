"""Where the meshes of a robot description lie, and how MuJoCo reads them."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np

from infomap_ros.errors import RobotModelError

_SCHEME = "file://"
_PACKAGE = "package://"
_READABLE = (".stl", ".obj", ".msh")
_MOST_TRIANGLES = 200_000  # that MuJoCo takes
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def with_absolute_meshes(xml: str, path: Path) -> str:
    """A URDF whose mesh files can be found from anywhere.

    Relative names, and ``package://`` names of a folder above the file, become ``file://`` ones.

    Args:
        xml: text of the URDF.
        path: where it was read from.

    Raises:
        RobotModelError: it is not XML.
    """
    try:
        tree = ElementTree.fromstring(xml)
    except ElementTree.ParseError as error:
        raise RobotModelError(f"robot description {path}: {error}") from error
    meshes = list(tree.iter("mesh"))
    for mesh in meshes:
        found = _located(mesh.get("filename", ""), path.resolve().parent)
        if found is not None:
            mesh.set("filename", f"{_SCHEME}{found}")
    return ElementTree.tostring(tree, encoding="unicode") if meshes else xml


def _located(name: str, folder: Path) -> Path | None:
    if name.startswith(_PACKAGE):
        inside = name.removeprefix(_PACKAGE)
        candidates = [above / inside for above in (folder, *folder.parents)]
    elif "://" in name:
        return None
    else:
        candidates = [folder / name]
    return next((each.resolve() for each in candidates if each.is_file()), None)


def prepare_meshes(robot: ElementTree.Element) -> dict[str, bytes]:
    """Give MuJoCo plain file names, and meshes that it cannot read as those that it can.

    Others, such as Collada files, are read as the collision checks of planning read them, and
    handed over as STL, without their colors. What cannot be read at all is left out of what is
    drawn, and refused where it collides.

    Args:
        robot: root of the URDF; changed.

    Returns:
        Content of the files that stand for others, by name.

    Raises:
        RobotModelError: a collision mesh cannot be read.
    """
    files: dict[str, bytes] = {}
    for link in robot.findall("link"):
        for kind in ("visual", "collision"):
            for part in link.findall(kind):
                mesh = part.find("geometry/mesh")
                if mesh is None or _is_readable(mesh):
                    continue
                try:
                    files |= _as_stl(mesh)
                except RobotModelError as error:
                    if kind == "collision":
                        text = f"link '{link.get('name')}' has the collision mesh "
                        raise RobotModelError(f"{text}{error}") from error
                    link.remove(part)
    for mesh in robot.iter("mesh"):
        mesh.set("filename", mesh.get("filename", "").removeprefix(_SCHEME))
    return files


def unreadable_meshes(description: str) -> list[str]:
    """Links whose collision meshes MuJoCo cannot read by itself, each once, in order."""
    links = ElementTree.fromstring(description).findall("link")
    found = [
        link.get("name", "")
        for link in links
        for mesh in link.iterfind("collision/geometry/mesh")
        if not _is_readable(mesh)
    ]
    return list(dict.fromkeys(found))


def _is_readable(mesh: ElementTree.Element) -> bool:
    return mesh.get("filename", "").lower().endswith(_READABLE)


def _as_stl(mesh: ElementTree.Element) -> dict[str, bytes]:
    """Name a file of its own for a mesh; returns it with its content."""
    name = mesh.get("filename", "").removeprefix(_SCHEME)
    content = _stl_of(name)
    mesh.set("filename", f"{name}{_READABLE[0]}")
    return {f"{name}{_READABLE[0]}": content}


@lru_cache(maxsize=256)
def _stl_of(name: str) -> bytes:
    """A mesh file as binary STL.

    Raises:
        RobotModelError: it cannot be read, or is too large to be drawn.
    """
    try:
        model = coal.MeshLoader().load(name, np.ones(3))
        vertices = np.asarray(model.vertices(), dtype=np.float32).reshape(-1, 3)
        faces = (model.tri_indices(index) for index in range(model.num_tris))
        corners = [(face[0], face[1], face[2]) for face in faces]
    except (ValueError, RuntimeError) as error:
        raise RobotModelError(f"{name}, which cannot be read: {error}") from error
    if not 0 < len(corners) < _MOST_TRIANGLES:
        raise RobotModelError(f"{name}, which has {len(corners)} triangles")
    triangles = vertices[np.array(corners)]
    rows = np.zeros(len(triangles), dtype=_STL)
    rows["corners"] = triangles
    return bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()
