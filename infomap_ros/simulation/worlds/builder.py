"""Builds a MuJoCo world and, from the same numbers, its true surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import SimulationError
from infomap_ros.geometry import quaternion_from_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot import add_robot
from infomap_ros.simulation.cameras.rendering import COLLISION_GROUP
from infomap_ros.simulation.worlds.surface import SurfaceModel, SurfacePart
from infomap_ros.simulation.worlds.terrain import Terrain
from infomap_ros.simulation.worlds.textures import Image

import mujoco  # isort: skip  # after the backend has been chosen

_PLATE = 0.01  # [m] thickness of a triangle that is touched
_LEAST_PLATE = 1e-5  # [m^2] area from which on it is


BOX_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class World:
    """A compiled world.

    Attributes:
        model: the MuJoCo model.
        terrain: its ground.
        surface: exact distances to everything but the robots.
        spec: what it was compiled from; to be copied, not changed.
        has_robot: whether a robot is in it.
        start: where a robot starts: x, y [m], yaw [rad].
        region: the part that is to be explored: lowest and highest corner, shape (2, 3) [m].
        T_world_target: where the target is whose frame robots take for the map, shape (4, 4);
            None where there is none.
        note: what a user should know of how it was made; empty for nothing.
    """

    model: mujoco.MjModel
    terrain: Terrain
    surface: SurfaceModel
    spec: mujoco.MjSpec
    has_robot: bool = False
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    region: FloatArray = field(default_factory=lambda: np.array([[-np.inf] * 3, [np.inf] * 3]))
    T_world_target: FloatArray | None = None
    note: str = ""

    def surface_distance(self, points: ArrayLike) -> FloatArray:
        """Exact distance to the nearest surface; (N, 3) in the world [m] -> (N,) [m].

        Never negative. Robots are not part of the surface. Surfaces inside another body (the
        ground under a rock) count too.
        """
        return self.surface.distance(points)

    def new_data(self) -> mujoco.MjData:
        """A fresh state of the model, positions computed."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        return data


@dataclass(eq=False)
class SceneBuilder:
    """Collects materials and bodies; `compile` turns them into a `World`.

    Attributes:
        terrain: the ground of the world, for those who place things on it.
        start: where a robot starts: x, y [m], yaw [rad].
        region: the part that is to be explored: lowest and highest corner, shape (2, 3) [m].
        T_world_target: where the target is, shape (4, 4); None where there is none.
        sun: whether the sun shines.
        ambient: light from everywhere, red, green, blue.
        note: of `World`.
    """

    terrain: Terrain
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    region: FloatArray = field(default_factory=lambda: np.array([[-np.inf] * 3, [np.inf] * 3]))
    T_world_target: FloatArray | None = None
    sun: bool = True
    ambient: tuple[float, float, float] = (0.34, 0.34, 0.37)
    note: str = ""
    _spec: mujoco.MjSpec = field(default_factory=mujoco.MjSpec, init=False)
    _parts: list[SurfacePart] = field(default_factory=list, init=False)
    _has_robot: bool = field(default=False, init=False)

    def add_material(self, name: str, image: Image) -> None:
        """Add a matt material whose image, upright, covers each face of a body."""
        sideways = np.rot90(image)
        self._add_cube(name, (sideways, sideways, *[image] * 4))

    def add_faces(self, name: str, images: Sequence[Image]) -> None:
        """Add a matt material for boxes with an upright image for each face +x -x +y -y +z -z."""
        self._add_cube(name, [np.rot90(images[0]), np.rot90(images[1]), *images[2:]])

    def _add_cube(self, name: str, faces: Sequence[Image]) -> None:
        """A material of six faces as MuJoCo wants them: columns run along y on the first two."""
        add_cube_material(self._spec, name, faces)

    def add_ground_material(self, name: str, image: Image, tile: float) -> None:
        """Add a matt material for the ground; the image repeats every `tile` [m]."""
        texture = self._spec.add_texture(
            name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=len(image), height=len(image)
        )
        texture.nchannel = 3
        texture.data = image.tobytes()
        material = _add_matt(self._spec, name)
        material.texuniform = True
        material.texrepeat = (1.0 / tile, 1.0 / tile)

    def add_terrain(self, material: str) -> None:
        """Add the ground."""
        heights, half = self.terrain.heights, self.terrain.half
        low, span = float(heights.min()), max(float(np.ptp(heights)), 1e-6)
        rows, columns = heights.shape
        self._spec.add_hfield(
            name="ground",
            nrow=rows,
            ncol=columns,
            size=(half, half, span, 0.5),
            userdata=((heights - low) / span).ravel().astype(np.float32),
        )
        self._spec.worldbody.add_geom(
            name="ground",
            type=mujoco.mjtGeom.mjGEOM_HFIELD,
            hfieldname="ground",
            pos=(0.0, 0.0, low),
            material=material,
        )
        self._parts.append(SurfacePart("ground", *self.terrain.triangles()))

    def add_box(
        self, name: str, size: tuple[float, float, float], transform: FloatArray, material: str
    ) -> None:
        """Add a box with edge lengths `size` [m] at ``T_world_box``, shape (4, 4)."""
        x, y, z, w = quaternion_from_transform(transform)
        self._spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=tuple(0.5 * edge for edge in size),
            pos=transform[:3, 3],
            quat=(w, x, y, z),
            material=material,
        )
        corners = transform_points(transform, BOX_CORNERS * np.asarray(size))
        self._parts.append(SurfacePart(name, corners, BOX_FACES))

    def add_mesh(
        self,
        name: str,
        vertices: FloatArray,
        faces: NDArray[np.int64],
        transform: FloatArray,
        material: str,
    ) -> None:
        """Add a closed mesh: vertices (V, 3) [m], outward faces (F, 3), ``T_world_mesh`` (4, 4).

        It collides as its convex hull.
        """
        mesh = self._spec.add_mesh(name=name)
        mesh.uservert = vertices.ravel().astype(np.float32)
        mesh.userface = faces.ravel().astype(np.int32)
        x, y, z, w = quaternion_from_transform(transform)
        self._spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            pos=transform[:3, 3],
            quat=(w, x, y, z),
            material=material,
        )
        self._parts.append(SurfacePart(name, transform_points(transform, vertices), faces))

    def add_shell_material(self, name: str, image: Image) -> None:
        """Add a matt material for `add_shell`, which repeats the image."""
        texture = self._spec.add_texture(
            name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=len(image), height=len(image)
        )
        texture.nchannel = 3
        texture.data = image.tobytes()
        _add_matt(self._spec, name)

    def add_shell(
        self,
        name: str,
        triangles: FloatArray,
        material: str,
        tile: float,
        *,
        is_touched: bool = True,
    ) -> None:
        """Add surfaces that are seen from both sides, convex or not.

        Each triangle collides as a plate of a centimeter. The image lies upright on what is
        steep.

        Args:
            name: of the surfaces.
            triangles: corners in the world, shape (F, 3, 3) [m].
            material: of `add_shell_material`.
            tile: length after which the image repeats [m].
            is_touched: whether it collides.
        """
        a, b, c = (triangles[:, k] for k in range(3))
        normals = np.cross(b - a, c - a)
        areas = 0.5 * np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / (2.0 * areas)
        both = np.concatenate([triangles, triangles[:, ::-1]])
        faces = np.arange(3 * len(both)).reshape(-1, 3)
        self._add_shell_picture(name, both, np.concatenate([normals, normals]), material, tile)
        self._parts.append(SurfacePart(name, both.reshape(-1, 3), faces))
        for row in np.flatnonzero(areas[:, 0] > _LEAST_PLATE) if is_touched else ():
            lifted = [triangles[row] + side * _PLATE * normals[row] for side in (-0.5, 0.5)]
            plate = self._spec.add_mesh(name=f"{name}_{row}")
            plate.uservert = np.concatenate(lifted).ravel().astype(np.float32)
            self._spec.worldbody.add_geom(
                name=f"{name}_{row}",
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=f"{name}_{row}",
                group=COLLISION_GROUP,
            )

    def add_unseen_box(self, name: str, low: FloatArray, high: FloatArray) -> None:
        """Add an upright box that is only touched, between two corners, shape (3,) [m]."""
        self._spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=0.5 * (high - low),
            pos=0.5 * (low + high),
            group=COLLISION_GROUP,
        )

    def _add_shell_picture(
        self, name: str, triangles: FloatArray, normals: FloatArray, material: str, tile: float
    ) -> None:
        """What is drawn: the image lies along the two axes that a triangle is turned least from."""
        steep = np.abs(normals[:, 2]) < 0.7
        along_y = np.abs(normals[:, 0]) > np.abs(normals[:, 1])
        u = np.where((steep & along_y)[:, None], triangles[..., 1], triangles[..., 0])
        v = np.where(steep[:, None], triangles[..., 2], triangles[..., 1])
        faces = np.arange(3 * len(triangles), dtype=np.int32)
        mesh = self._spec.add_mesh(name=name)
        mesh.uservert = triangles.ravel().astype(np.float32)
        mesh.userface = faces
        mesh.usertexcoord = (np.stack([u, v], axis=-1) / tile).ravel().astype(np.float32)
        mesh.userfacetexcoord = faces
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        self._spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            material=material,
            contype=0,
            conaffinity=0,
        )

    def add_robot(self, description: str, material: str, prefix: str = "rover/") -> None:
        """Add a robot from its URDF; see `robot.add_robot`."""
        add_robot(self._spec, description, prefix, material)
        self._has_robot = True

    def compile(self) -> World:
        """Finish the world.

        Raises:
            SimulationError: MuJoCo refuses it.
        """
        self._add_light()
        spec = self._spec
        spec.stat.extent = 10.0
        spec.stat.center = (0.0, 0.0, 0.0)
        spec.visual.map.znear, spec.visual.map.zfar = 0.002, 10.0
        spec.visual.quality.shadowsize = 4096
        spec.visual.quality.offsamples = 4
        try:
            model = spec.compile()
        except ValueError as error:
            raise SimulationError(f"MuJoCo refuses the world: {error}") from error
        surface = SurfaceModel(self._parts)
        return World(
            model,
            self.terrain,
            surface,
            spec,
            self._has_robot,
            self.start,
            self.region,
            self.T_world_target,
            self.note,
        )

    def _add_light(self) -> None:
        """Low sun with shadows, light from the sky, and a plain sky."""
        if self.sun:
            self._add_sun()
        headlight = self._spec.visual.headlight
        headlight.ambient = self.ambient
        headlight.diffuse = headlight.specular = (0.0, 0.0, 0.0)
        self._spec.add_texture(
            name="sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=(0.96, 0.92, 0.87),
            rgb2=(1.0, 0.98, 0.94),
            width=64,
            height=384,
        )

    def _add_sun(self) -> None:
        self._spec.worldbody.add_light(
            name="sun",
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=(-4.0, 5.0, 8.0),
            dir=(0.50, -0.55, -0.80),
            diffuse=(0.78, 0.76, 0.70),
            specular=(0.0, 0.0, 0.0),
            castshadow=True,
        )


def add_cube_material(spec: mujoco.MjSpec, name: str, faces: Sequence[Image]) -> None:
    """Add a matt material of six square images to a world, as MuJoCo wants them.

    Args:
        spec: the world.
        name: of the material.
        faces: for +x -x +y -y +z -z, shape (n, n, 3) each; columns run along y on the first two.
    """
    side = len(faces[0])
    texture = spec.add_texture(
        name=name, type=mujoco.mjtTexture.mjTEXTURE_CUBE, width=side, height=6 * side
    )
    texture.nchannel = 3
    texture.data = np.concatenate(faces).tobytes()
    _add_matt(spec, name)


def _add_matt(spec: mujoco.MjSpec, name: str) -> mujoco.MjsMaterial:
    """A material without gloss: what shines looks different to each camera."""
    material = spec.add_material(name=name, specular=0.0, shininess=0.0, reflectance=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return material
