"""Worlds out of files: a mesh that Assimp reads, a floor plan of map_server, an OctoMap tree."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.mesh_files import read_triangles
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.files.octomap_file import read_octree
from infomap_ros.simulation.worlds import textures
from infomap_ros.simulation.worlds.builder import BOX_CORNERS, BOX_FACES, SceneBuilder, World
from infomap_ros.simulation.worlds.rocks import Places
from infomap_ros.simulation.worlds.surface import SurfaceModel, SurfacePart
from infomap_ros.simulation.worlds.target_board import stand_board_ahead
from infomap_ros.simulation.worlds.terrain import Terrain

PLANS = (".yaml", ".yml")
OCTREES = (".bt", ".ot")
MESHES = (".stl", ".obj", ".dae", ".ply", ".glb", ".gltf")
WORLD_FILES = (*MESHES, *PLANS, *OCTREES)

_LARGEST = 250.0  # [m]; a world of 330 m did not fit in memory
_MILLIMETERS = 1000.0  # extent from which on a mesh is taken to be in millimeters
_LEVEL = 0.95  # cosine of the slope up to which a triangle counts as floor
_FLOOR_SHARE = 0.5  # of the largest level, that the lowest one must have to be the floor
_BIN = 0.1  # [m] between levels
_BETWEEN = 0.1  # [m] between samples of a surface
_HEADROOM = 0.6  # [m] above what may be the floor
_ON_THE_FLOOR = 0.02  # [m] within which the mesh's floor is the ground
_MOST_TRIANGLES = 20_000  # each is a body of its own to what touches it
_MOST_BOXES = 10_000  # likewise
_TALLEST = 2.5  # [m] of what is to be explored: one storey
_AHEAD = 1.5  # [m] from the start to the target
_ROOM, _HEIGHTS = 0.7, (0.1, 0.5, 1.0)  # [m] about the start that should be free, and where
_GRID = 0.3  # [m] between places that are tried for the start
_FAR = 1000.0  # [m]


@dataclass(frozen=True)
class FileWorldConfig:
    """Parameters of a world out of a file.

    Raises:
        ConfigError: a value is out of its range.
    """

    file: str = parameter("", "Mesh, .yaml of a floor plan, or .bt or .ot of OctoMap.")
    seed: int = parameter(1, "Seed of its textures.", low=0)
    size: float = parameter(
        0.0, "Edge of the part about the start that is to be explored; 0 for all.", unit="m",
        low=0.0, high=1000.0,
    )  # fmt: skip
    up: str = parameter("auto", "Axis of a mesh that is up.", choices=("auto", "y", "z"))
    unit: float = parameter(
        0.0, "Meters in one unit of a mesh; 0 to guess.", unit="m", low=0.0, high=1000.0
    )
    start: tuple[float, ...] = parameter(
        (), "Place x, y of the file at which the robot starts; empty to look for one.", unit="m"
    )
    walls: float = parameter(
        1.5, "Height of the walls of a floor plan.", unit="m", low=0.2, high=10.0
    )
    texture_size: int = parameter(
        1024, "Edge length of the textures.", unit="px", low=64, high=8192
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class _Content:
    """What stands on the ground of a world.

    Attributes:
        triangles: all that is seen, shape (F, 3, 3) [m].
        boxes: lowest and highest corners of what is touched, shape (N, 2, 3) [m]; None for the
            triangles themselves.
        said: what was found, for the user.
    """

    triangles: FloatArray
    boxes: FloatArray | None
    said: str

    def moved(self, x: float, y: float) -> _Content:
        """The same elsewhere."""
        by = np.array((x, y, 0.0))
        boxes = None if self.boxes is None else self.boxes + by
        return _Content(self.triangles + by, boxes, self.said)


def is_world_file(name: str) -> bool:
    """Whether a world's name is that of a file of a kind that can be read."""
    return Path(name).suffix.lower() in WORLD_FILES


def file_world(config: FileWorldConfig, description: str = "") -> World:
    """Make a world of a file: what it shows stands on level ground, and the robot inside of it.

    The floor of a mesh becomes the ground where it is level. The world's origin is where the robot
    starts, and its axes are those of the file, whose up axis is z.

    Args:
        config: the parameters.
        description: URDF text of a robot to put in; empty for none.

    Raises:
        InvalidInputError: the file cannot be read, or holds nothing that can be explored.
    """
    path = Path(config.file)
    if not path.is_file():
        raise InvalidInputError("world", f"{path} does not exist")
    kind = path.suffix.lower()
    if kind in OCTREES:
        found = _octree(path)
    else:
        found = _plan(path, config.walls) if kind in PLANS else _mesh(path, config)
    x, y = _start(found.triangles, config, path)
    note = f"{path.name}: {found.said}, the robot starts at ({x:.2f}, {y:.2f}) of the file"
    return _build(found.moved(-x, -y), config, description, note)


def _mesh(path: Path, config: FileWorldConfig) -> _Content:
    """Triangles of a mesh with its floor at z = 0, and what was guessed."""
    triangles = read_triangles(path)
    if not np.isfinite(triangles).all():
        raise InvalidInputError("world", f"{path} holds a vertex that is not finite")
    extent = np.ptp(triangles, axis=(0, 1))
    guess = 0.001 if extent.max() > _MILLIMETERS else 1.0
    unit = config.unit or _stated_unit(path) or guess
    up = config.up if config.up != "auto" else "y" if extent[1] < 0.5 * extent[2] else "z"
    if up == "y":
        triangles = np.stack([triangles[..., 0], -triangles[..., 2], triangles[..., 1]], axis=-1)
    triangles = unit * triangles
    triangles = triangles[_areas(triangles) > 0.0]
    if not len(triangles):
        raise InvalidInputError("world", f"{path} holds no triangle with an area")
    if len(triangles) > _MOST_TRIANGLES:
        found = f"{path} has {len(triangles)} triangles, at most {_MOST_TRIANGLES} can be simulated"
        raise InvalidInputError("world", f"{found}: simplify it")
    x, y, z = np.ptp(triangles, axis=(0, 1))
    if max(x, y, z) > _LARGEST:
        found = (
            f"{path} is {x:.0f} x {y:.0f} x {z:.0f} m, at most {_LARGEST:.0f} m can be simulated"
        )
        raise InvalidInputError("world", f"{found}: is its unit right?")
    triangles = triangles - (0.0, 0.0, _floor(triangles))
    length = "millimeters" if unit == 0.001 else "meters" if unit == 1.0 else f"units of {unit:g} m"
    return _Content(triangles, None, f"{length}, {up} is up, {x:.1f} x {y:.1f} x {z:.1f} m")


def _stated_unit(path: Path) -> float:
    """Meters in one unit, where a COLLADA file states another than the meter it begins with."""
    is_collada = path.suffix.lower() == ".dae"
    head = path.read_bytes()[:100_000] if is_collada else b""
    stated = re.search(rb'<unit\b[^>]*\bmeter\s*=\s*"\s*([0-9.eE+-]+)\s*"', head)
    try:
        unit = float(stated[1]) if stated else 0.0
    except ValueError:
        return 0.0
    return unit if math.isfinite(unit) and unit > 0.0 and unit != 1.0 else 0.0


def _areas(triangles: FloatArray) -> FloatArray:
    a, b, c = (triangles[:, k] for k in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _floor(triangles: FloatArray) -> float:
    """Height of the lowest large level part with room above it; the lowest point without any."""
    surface = _surface_of(triangles)
    points, normals = surface.samples(_BETWEEN, np.random.default_rng(0))
    points = points[np.abs(normals[:, 2]) > _LEVEL]
    lift, room = (0.0, 0.0, _ON_THE_FLOOR), (0.0, 0.0, _HEADROOM)
    points = points[~np.isfinite(surface.first_hits(points + lift, points + room))]
    lowest = float(triangles[..., 2].min())
    if not len(points):
        return lowest
    bins = np.floor((points[:, 2] - lowest) / _BIN).astype(int)
    counts = np.bincount(bins)
    floor = int(np.flatnonzero(counts >= _FLOOR_SHARE * counts.max())[0])
    return float(np.median(points[bins == floor, 2]))


def _surface_of(triangles: FloatArray) -> SurfaceModel:
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    return SurfaceModel([SurfacePart("mesh", triangles.reshape(-1, 3), faces)])


def _plan(path: Path, walls: float) -> _Content:
    """The walls of a floor plan as map_server writes it."""
    try:
        content = yaml.safe_load(path.read_text())
        image, edge = path.parent / str(content["image"]), float(content["resolution"])
        x, y = (float(value) for value in content["origin"][:2])
        limit, negate = float(content.get("occupied_thresh", 0.65)), bool(content.get("negate", 0))
    except (OSError, yaml.YAMLError, LookupError, TypeError, ValueError, RecursionError) as error:
        raise InvalidInputError("world", f"{path} is no map_server file ({error!r})") from error
    gray = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
    if gray is None:
        raise InvalidInputError("world", f"{path}: its image {image} cannot be read")
    share = gray / 255.0 if negate else 1.0 - gray / 255.0
    occupied = np.flipud(share > limit)  # row 0 of the image is at the largest y
    found = _rectangles(occupied)
    if not len(found):
        raise InvalidInputError("world", f"{path} shows no wall")
    boxes = np.zeros((len(found), 2, 3))
    boxes[:, :, :2] = found.reshape(-1, 2, 2) * edge + (x, y)
    boxes[:, 1, 2] = walls
    width, depth = gray.shape[1] * edge, gray.shape[0] * edge
    said = f"{width:.1f} x {depth:.1f} m, walls of {walls:g} m"
    return _Content(_faces(boxes), boxes, said)


def _faces(boxes: FloatArray) -> FloatArray:
    """Triangles of boxes, shape (12 N, 3, 3) [m]."""
    corners = boxes.mean(axis=1)[:, None] + np.diff(boxes, axis=1) * BOX_CORNERS
    return np.asarray(corners[:, BOX_FACES].reshape(-1, 3, 3))


def _octree(path: Path) -> _Content:
    """What stands above the floor of an octree, in voxels so large that it can be simulated."""
    leaves = read_octree(path)
    voxels, edge = leaves.occupied_voxels().astype(np.int64), leaves.resolution
    if not len(voxels):
        raise InvalidInputError("world", f"{path} holds nothing that is occupied")
    layers = np.bincount(voxels[:, 2] - voxels[:, 2].min())
    # as of a mesh: the lowest large level
    above = voxels[:, 2].min() + int(np.flatnonzero(layers >= _FLOOR_SHARE * layers.max())[0]) + 1
    voxels = voxels[voxels[:, 2] >= above] - (0, 0, above)
    x, y, z = (np.ptp(voxels, axis=0) + 1) * edge if len(voxels) else np.zeros(3)
    found = _cuboids(voxels)
    while len(found) > _MOST_BOXES:
        voxels, edge = np.unique(voxels // 2, axis=0), 2.0 * edge
        found = _cuboids(voxels)
    boxes = np.asarray(edge * found.reshape(-1, 2, 3), np.float64)
    said = f"{x:.1f} x {y:.1f} x {z:.1f} m above its floor, {len(boxes)} boxes of {edge:g} m voxels"
    return _Content(_faces(boxes), boxes, said)


def _cuboids(voxels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Boxes that cover voxels (N, 3): first x, y, z and last + 1, shape (M, 6).

    Rectangles of a layer go on in the next one where it has the same rectangle.
    """
    found: list[tuple[int, ...]] = []
    open_ones: dict[tuple[int, ...], int] = {}
    low = voxels.min(axis=0, initial=0)
    shape = (voxels.max(axis=0, initial=-1) + 1 - low)[:2]
    for layer in range(int(low[2]), int(voxels[:, 2].max(initial=-1)) + 2):
        here = voxels[voxels[:, 2] == layer] - low
        grid = np.zeros(shape[::-1], np.bool_)
        grid[here[:, 1], here[:, 0]] = True
        there = set(map(tuple, _rectangles(grid).tolist()))
        for one in open_ones.keys() - there:
            found.append((*one[:2], open_ones[one], *one[2:], layer))
        open_ones = {one: open_ones.get(one, layer) for one in there}
    offset = (low[0], low[1], 0, low[0], low[1], 0)
    return np.array(sorted(found), np.int64).reshape(-1, 6) + offset


def _rectangles(occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Rectangles that cover the cells of a grid (y, x): first x, y and last + 1, shape (N, 4).

    Runs of a row go on in the next one where it has the same run.
    """
    found: list[tuple[int, int, int, int]] = []
    open_runs: dict[tuple[int, int], int] = {}
    for row in range(len(occupied) + 1):
        runs: set[tuple[int, int]] = set()
        if row < len(occupied):
            steps = np.flatnonzero(np.diff(occupied[row].astype(np.int8), prepend=0, append=0))
            runs = set(zip(steps[::2].tolist(), steps[1::2].tolist(), strict=True))
        for run in open_runs.keys() - runs:
            found.append((run[0], open_runs[run], run[1], row))
        open_runs = {run: open_runs.get(run, row) for run in runs}
    return np.array(sorted(found), np.int64).reshape(-1, 4)


def _start(triangles: FloatArray, config: FileWorldConfig, path: Path) -> tuple[float, float]:
    """Where the robot begins: inside, near to the middle, with room for it and for the target."""
    if config.start:
        if len(config.start) != 2:
            raise InvalidInputError("world.start", f"{config.start}, expected x, y")
        return config.start[0], config.start[1]
    above = triangles[triangles[..., 2].max(axis=1) > _ON_THE_FLOOR]
    if not len(above):
        raise InvalidInputError("world", f"{path} holds nothing but a floor")
    surface = _surface_of(above)
    low, high = triangles.min(axis=(0, 1))[:2], triangles.max(axis=(0, 1))[:2]
    axes = [np.arange(a, b, _GRID) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes)).reshape(2, -1).T
    beside = places + np.array((_AHEAD, 0.3))
    room = np.minimum(_room(surface, places), _room(surface, beside))
    room[_walls_around(surface, places) < 4] -= _ROOM
    middle = np.linalg.norm(places - 0.5 * (low + high), axis=1)
    best = np.lexsort((middle, -np.minimum(room, _ROOM)))[0]
    if room[best] <= 0.0:
        raise InvalidInputError("world", f"{path} has no room for a robot; say where: start")
    return float(places[best, 0]), float(places[best, 1])


def _room(surface: SurfaceModel, places: FloatArray) -> FloatArray:
    """Distance to the nearest thing as high as a robot, shape (N,) [m]."""
    at = [np.column_stack([places, np.full(len(places), height)]) for height in _HEIGHTS]
    return np.asarray(np.min([surface.distance(points) for points in at], axis=0))


def _walls_around(surface: SurfaceModel, places: FloatArray) -> NDArray[np.int64]:
    """In how many of four directions something stands, shape (N,)."""
    origins = np.column_stack([places, np.full(len(places), _HEIGHTS[1])])
    rays = _FAR * np.array([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
    hits = [np.isfinite(surface.first_hits(origins, origins + ray)) for ray in rays]
    return np.asarray(np.sum(hits, axis=0))


def _build(content: _Content, config: FileWorldConfig, description: str, note: str) -> World:
    rng, triangles = np.random.default_rng(config.seed), content.triangles
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    half = float(np.abs([low[:2], high[:2]]).max()) + 0.5
    nodes = 2 * round(2.0 * half) + 1
    builder = SceneBuilder(Terrain(np.zeros((nodes, nodes)), half))
    builder.ambient, builder.note = (0.62, 0.62, 0.60), note
    edge = 0.5 * config.size if config.size else np.inf
    top = min(float(high[2]), _TALLEST)
    builder.region = np.array(
        [(*np.maximum(low[:2], -edge), -0.1), (*np.minimum(high[:2], edge), top)]
    )
    size = config.texture_size
    builder.add_ground_material("ground", textures.carpet(size, rng), tile=1.6)
    builder.add_shell_material("walls", textures.bricks(size, rng))
    builder.add_material("paint", textures.worn_paint(max(64, size // 2), rng))
    builder.add_terrain("ground")
    above = triangles[np.abs(triangles[..., 2]).max(axis=1) > _ON_THE_FLOOR]
    builder.add_shell("walls", above, "walls", 2.0, is_touched=content.boxes is None)
    for number, (lowest, highest) in enumerate(() if content.boxes is None else content.boxes):
        builder.add_unseen_box(f"wall_{number}", lowest, highest)
    stand_board_ahead(builder, Places(rng, 0.0), _AHEAD)
    if description:
        builder.add_robot(description, "paint")
    return builder.compile()
