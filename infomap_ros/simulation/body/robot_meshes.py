"""Where the meshes of a robot description lie, and which of them MuJoCo can read."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from infomap_ros.errors import RobotModelError

_SCHEME = "file://"
_PACKAGE = "package://"
_READABLE = (".stl", ".obj", ".msh")


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


def prepare_meshes(robot: ElementTree.Element) -> None:
    """Give MuJoCo plain file names, and leave out what it cannot read and need not know.

    Args:
        robot: root of the URDF; changed.

    Raises:
        RobotModelError: a collision mesh is of a kind that MuJoCo cannot read.
    """
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and not _is_readable(mesh):
                link.remove(visual)
        for mesh in link.iterfind("collision/geometry/mesh"):
            if not _is_readable(mesh):
                raise RobotModelError(
                    f"link '{link.get('name')}' has the collision mesh {mesh.get('filename')}, "
                    f"which is none of {', '.join(_READABLE)}"
                )
    for mesh in robot.iter("mesh"):
        mesh.set("filename", mesh.get("filename", "").removeprefix(_SCHEME))


def _is_readable(mesh: ElementTree.Element) -> bool:
    return mesh.get("filename", "").lower().endswith(_READABLE)
