"""The robot description (URDF) inside a MuJoCo world: the URDF is the only truth.

Where the meshes of a robot description lie, and how MuJoCo reads them.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ResourceError, RobotModelError
from infomap_ros.geometry import TransformRecord, make_transform, quaternion_from_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.extended_description import mend_inertias
from infomap_ros.simulation.cameras.rendering import COLLISION_GROUP

import mujoco  # isort: skip  # after the backend has been chosen


_SCHEME = "file://"
_PACKAGE = "package://"
_READABLE = (".stl", ".obj", ".msh")
_MOST_TRIANGLES = 200_000  # that MuJoCo takes
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def with_absolute_meshes(xml: str, path: Path) -> str:
    """A URDF whose mesh files can be found from anywhere.

    Relative names, and ``package://`` names of a folder above the file or of a package that
    `find_description` finds, become ``file://`` ones.

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
        candidates = [root / inside for root in (folder, *folder.parents, *_package_roots())]
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
    name = mesh.get("filename", "").removeprefix(_SCHEME)
    return name.lower().endswith(_READABLE) and Path(name).is_file()


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


LEFT_OPTICAL_FRAME = "left_camera_optical_frame"
RIGHT_OPTICAL_FRAME = "right_camera_optical_frame"


def find_description(place: str, folder: Path | None = None) -> Path:
    """Find a URDF by a path or a ``package://`` address.

    Paths are looked for beside the file that names them, in the current folder, and below the
    share folder of this package. Packages are those of ROS_PACKAGE_PATH and AMENT_PREFIX_PATH,
    and Python packages that are installed.

    Args:
        place: path or address.
        folder: of the file that names it.

    Raises:
        ResourceError: it is nowhere; names the places.
    """
    scheme = "package://"
    if place.startswith(scheme):
        inside = place.removeprefix(scheme)
        places = [root / inside for root in _package_roots()]
    else:
        places = [one / place for one in (folder, Path()) if one is not None]
    for one in places:
        if one.is_file():
            return one.resolve()
    if not place.startswith(scheme):
        return find_share(place)
    package = place.removeprefix(scheme).partition("/")[0]
    raise ResourceError(f"{place} is nowhere: install the package {package}, of ROS or of Python")


def _package_roots() -> Iterator[Path]:
    """Folders that hold packages by their names."""
    yield from map(Path, filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)))
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield Path(prefix) / "share"
    for site in dict.fromkeys([sysconfig.get_path("purelib"), *sys.path]):
        yield Path(site) / "cmeel.prefix" / "share"
        yield Path(site)


def read_description(path: Path, baseline: float | None = None) -> str:
    """Read a URDF and, if asked, move its stereo cameras apart.

    Args:
        path: the URDF file.
        baseline: distance of the cameras [m]; None keeps the description's.

    Returns:
        The URDF as text, its mesh files named so that they are found from anywhere.

    Raises:
        RobotModelError: the file cannot be read, is not XML, or lacks the camera joints.
    """
    try:
        text = path.read_text(encoding="utf-8")
        if baseline is None:
            return with_absolute_meshes(text, path)
        tree = ElementTree.fromstring(text)
    except (OSError, ElementTree.ParseError) as error:
        raise RobotModelError(f"robot description {path}: {error}") from error
    for joint, offset in (("left_camera_joint", 0.5), ("right_camera_joint", -0.5)):
        origin = tree.find(f"joint[@name='{joint}']/origin")
        if origin is None:
            raise RobotModelError(f"robot description {path} has no joint '{joint}' with an origin")
        x, _, z = origin.get("xyz", "0 0 0").split()
        origin.set("xyz", f"{x} {offset * baseline:.6g} {z}")
    return ElementTree.tostring(tree, encoding="unicode")


def fixed_frames(description: str, stamp: int = 0) -> list[TransformRecord]:
    """The fixed joints of a URDF, as ``/tf_static`` carries them.

    Raises:
        RobotModelError: the description is not XML or a number in it is malformed.
    """
    try:
        joints = ElementTree.fromstring(description).findall("joint[@type='fixed']")
        return [
            TransformRecord(
                stamp, _link(joint, "parent"), _link(joint, "child"), _origin(joint), is_static=True
            )
            for joint in joints
        ]
    except (ElementTree.ParseError, ValueError) as error:
        raise RobotModelError(f"robot description: {error}") from error


def moving_frames(description: str) -> list[tuple[str, str]]:
    """Parent and child link of every joint of a URDF that is not fixed.

    Raises:
        RobotModelError: the description is not XML.
    """
    try:
        joints = ElementTree.fromstring(description).findall("joint")
    except ElementTree.ParseError as error:
        raise RobotModelError(f"robot description: {error}") from error
    return [(_link(j, "parent"), _link(j, "child")) for j in joints if j.get("type") != "fixed"]


def stereo_baseline(description: str) -> float:
    """Distance of the two camera joints of a URDF [m].

    Raises:
        RobotModelError: the description lacks a camera, or they are not side by side.
    """
    edges = {edge.child_frame_id: edge for edge in fixed_frames(description)}
    try:
        left, right = edges["left_camera_frame"], edges["right_camera_frame"]
    except KeyError as error:
        raise RobotModelError(f"robot description has no fixed link {error}") from error
    offset = left.transform[:3, 3] - right.transform[:3, 3]
    if left.frame_id != right.frame_id or offset[1] <= 0.0 or abs(offset[[0, 2]]).max() > 1e-9:
        raise RobotModelError(
            "robot description: the left camera is not straight left of the right"
        )
    return float(offset[1])


def _link(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _origin(joint: ElementTree.Element) -> FloatArray:
    element = joint.find("origin")
    given = {} if element is None else element.attrib
    xyz = [float(number) for number in given.get("xyz", "0 0 0").split()]
    rpy = [float(number) for number in given.get("rpy", "0 0 0").split()]
    return make_transform(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)


def load_robot(description: str) -> mujoco.MjSpec:
    """A robot from its URDF, alone and fixed at its root link, ready to be changed or compiled.

    Visual shapes are drawn, collision shapes collide and are not drawn.

    Args:
        description: URDF text.

    Raises:
        RobotModelError: MuJoCo cannot read the description.
    """
    try:
        tree = ElementTree.fromstring(description)
        options = ElementTree.SubElement(ElementTree.SubElement(tree, "mujoco"), "compiler")
        options.set("discardvisual", "false")
        options.set("fusestatic", "false")
        options.set("strippath", "false")
        mend_inertias(tree)
        files = prepare_meshes(tree)
        robot = mujoco.MjSpec.from_string(ElementTree.tostring(tree, encoding="unicode"))
        robot.assets = {**robot.assets, **files}
    except (ElementTree.ParseError, ValueError) as error:
        raise RobotModelError(f"robot description: {error}") from error
    for mesh in robot.meshes:
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # some enclose no volume
    for geom in robot.geoms:
        if geom.contype or geom.conaffinity:
            geom.group = COLLISION_GROUP
    return robot


def add_robot(
    spec: mujoco.MjSpec, description: str, prefix: str = "rover/", material: str = ""
) -> mujoco.MjsBody:
    """Put a robot into a world that is being built, free to move.

    Args:
        spec: the world.
        description: URDF text, read by `load_robot`.
        prefix: put before the names of all bodies and joints, so that several robots fit.
        material: name of a material of `spec` that textures the robot's own colors.

    Returns:
        The robot's root body.

    Raises:
        RobotModelError: MuJoCo cannot read the description.
    """
    root = attach_robot(spec, load_robot(description), prefix, material)
    root.add_freejoint(name=f"{prefix}base")
    return root


def attach_robot(
    spec: mujoco.MjSpec, robot: mujoco.MjSpec, prefix: str, material: str
) -> mujoco.MjsBody:
    """Put what `load_robot` read into a world, fixed to it; see `add_robot`."""
    spec.assets = {**spec.assets, **robot.assets}
    root = spec.worldbody.add_frame().attach_body(robot.worldbody.first_body(), prefix, "")
    for geom in spec.geoms:
        if material and geom.group == 1:
            geom.material = material
    return root


class RobotState:
    """Places a robot of a compiled world by base pose and joint angles, without dynamics.

    Args:
        model: the compiled world.
        data: its state; changed by `place`.
        prefix: as given to `add_robot`.

    Raises:
        RobotModelError: the world has no such robot.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, prefix: str = "rover/") -> None:
        self._model, self._data, self._prefix = model, data, prefix
        self._addresses: dict[str, int] = {}
        for index in range(model.njnt):
            joint = model.joint(index)
            if joint.name.startswith(prefix):
                self._addresses[joint.name[len(prefix) :]] = int(joint.qposadr[0])
        if "base" not in self._addresses:
            raise RobotModelError(f"the world has no robot with prefix '{prefix}'")
        self._base = self._addresses.pop("base")

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, in the model's order."""
        return tuple(self._addresses)

    def place(self, T_world_base: FloatArray, joints: Mapping[str, float]) -> None:
        """Set base pose, shape (4, 4), and joint angles [rad]; joints not named keep theirs.

        Raises:
            RobotModelError: a joint is unknown.
        """
        unknown = set(joints) - set(self._addresses)
        if unknown:
            raise RobotModelError(f"unknown joint: {', '.join(sorted(unknown))}")
        x, y, z, w = quaternion_from_transform(T_world_base)
        self._data.qpos[self._base : self._base + 3] = T_world_base[:3, 3]
        self._data.qpos[self._base + 3 : self._base + 7] = (w, x, y, z)
        for name, angle in joints.items():
            self._data.qpos[self._addresses[name]] = angle
        mujoco.mj_kinematics(self._model, self._data)

    def frame(self, name: str) -> FloatArray:
        """``T_world_frame``, shape (4, 4), of a link of the description.

        Raises:
            RobotModelError: the description has no such link.
        """
        try:
            body = self._data.body(self._prefix + name)
        except KeyError as error:
            raise RobotModelError(f"the robot has no frame '{name}'") from error
        return make_transform(np.array(body.xmat).reshape(3, 3), body.xpos)
