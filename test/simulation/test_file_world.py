"""Worlds out of files: where walls, floor and robot are, by meshes written by hand."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.mapping.files.octomap_file import write_bt, write_ot
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.simulation.worlds import file_world
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import build_scene, describe_scene, make_world, scene_of

WIDTH, DEPTH, HEIGHT, THICK = 8.0, 6.0, 2.2, 0.2  # [m] of a room, inside


def box(low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
    """Twelve triangles, shape (12, 3, 3)."""
    corners = np.array([[(low, high)[(i >> k) & 1][k] for k in range(3)] for i in range(8)])
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return np.array([[corners[f[a]] for a in t] for f in faces for t in ((0, 1, 2), (0, 2, 3))])


def room(floor: float = 0.5) -> np.ndarray:
    """A room with a slab under it whose top is `floor` above the lowest point, and a pillar."""
    w, d, t, top = WIDTH, DEPTH, THICK, floor + HEIGHT
    parts = [
        box((-t, -t, 0.0), (w + t, d + t, floor)),
        box((-t, -t, floor), (0.0, d + t, top)), box((w, -t, floor), (w + t, d + t, top)),
        box((0.0, -t, floor), (w, 0.0, top)), box((0.0, d, floor), (w, d + t, top)),
        box((6.0, 4.5, floor), (6.4, 4.9, top)),
    ]  # fmt: skip
    return np.concatenate(parts)


def write_stl(path: Path, triangles: np.ndarray) -> str:
    lines = ["solid room"]
    for triangle in triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(f"{value:.6f}" for value in corner) for corner in triangle]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid room", ""]))
    return str(path)


def look(world: World, height: float = 0.5) -> list[float]:
    """Distance from the start to what stands in +x, +y, -x, -y [m]."""
    rays = 50.0 * np.array([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
    origin = np.array([[0.0, 0.0, height]])
    return [float(50.0 * world.surface.first_hits(origin, origin + ray)[0]) for ray in rays]


def check_room(world: World, start: tuple[float, float]) -> None:
    """The walls are where they were drawn, seen from the start."""
    ahead, left, behind, right = look(world, 1.5)  # above the target
    np.testing.assert_allclose(ahead + behind, WIDTH, atol=1e-3)
    np.testing.assert_allclose(left + right, DEPTH, atol=1e-3)
    np.testing.assert_allclose((behind, right), start, atol=1e-3)
    assert world.surface_distance(np.array([[0.0, 0.0, 0.4]]))[0] == pytest.approx(0.4, abs=0.02)


def test_a_mesh_in_meters_with_z_up(tmp_path: Path) -> None:
    file = write_stl(tmp_path / "room.stl", room())
    world = make_world(file, 1, start=(2.0, 2.5))
    check_room(world, (2.0, 2.5))
    assert "meters, z is up" in world.note and "(2.00, 2.50) of the file" in world.note
    assert world.T_world_target is not None
    np.testing.assert_allclose(world.region[:, 0], (-2.0 - THICK, WIDTH + THICK - 2.0), atol=1e-3)


def test_millimeters_and_another_axis_are_found_out(tmp_path: Path) -> None:
    turned = 1000.0 * room()[..., [0, 2, 1]] * (1.0, 1.0, -1.0)  # y is up
    world = make_world(write_stl(tmp_path / "room.stl", turned), 1, start=(2.0, 2.5))
    check_room(world, (2.0, 2.5))
    assert "millimeters, y is up" in world.note


def write_obj(path: Path, triangles: np.ndarray) -> None:
    lines = ["v " + " ".join(f"{value:.6f}" for value in v) for v in triangles.reshape(-1, 3)]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(triangles))]
    path.write_text("\n".join(lines) + "\n")


def write_ply(path: Path, triangles: np.ndarray) -> None:
    count = len(triangles)
    head = ["ply", "format ascii 1.0", f"element vertex {3 * count}"]
    head += [f"property float {axis}" for axis in "xyz"] + [f"element face {count}"]
    head += ["property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(f"{value:.6f}" for value in v) for v in triangles.reshape(-1, 3)]
    rows += [f"3 {3 * i} {3 * i + 1} {3 * i + 2}" for i in range(count)]
    path.write_text("\n".join([*head, *rows, ""]))


def write_dae(path: Path, triangles: np.ndarray, unit: float = 1.0, up: str = "Z_UP") -> None:
    count, numbers = len(triangles), " ".join(f"{value:.6f}" for value in triangles.ravel())
    places = " ".join(map(str, range(3 * count)))
    path.write_text(f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="unit" meter="{unit}"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{9 * count}">{numbers}</float_array>
<technique_common><accessor source="#a" count="{3 * count}" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{count}"><input semantic="VERTEX" source="#v" offset="0"/><p>{places}</p>
</triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
""")


def write_glb(path: Path, triangles: np.ndarray) -> None:
    vertices = triangles.reshape(-1, 3).astype("<f4")
    data = vertices.tobytes()
    ends = {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    accessor = {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"}
    content = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [accessor | ends], "buffers": [{"byteLength": len(data)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
    }  # fmt: skip
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


Y_UP = room()[..., [0, 2, 1]] * (1.0, 1.0, -1.0)


@pytest.mark.parametrize(
    ("name", "write", "triangles", "more"),
    [
        ("room.obj", write_obj, room(), {}),
        ("room.ply", write_ply, 1000.0 * room(), {}),
        ("room.ply", write_ply, 3.28084 * room(), {"unit": 0.3048}),  # feet
        ("room.obj", write_obj, Y_UP, {"up": "y"}),
        ("room.dae", write_dae, room(), {}),
        ("room.glb", write_glb, Y_UP, {}),  # as its standard has it
    ],
)
def test_a_room_is_the_same_out_of_every_format(
    tmp_path: Path,
    name: str,
    write: Callable[[Path, np.ndarray], None],
    triangles: np.ndarray,
    more: dict[str, Any],
) -> None:
    write(tmp_path / name, triangles)
    check_room(make_world(str(tmp_path / name), 1, start=(2.0, 2.5), **more), (2.0, 2.5))


def test_the_axis_and_the_unit_that_a_collada_file_states_hold(tmp_path: Path) -> None:
    write_dae(tmp_path / "inches.dae", Y_UP / 0.0254, 0.0254, "Y_UP")
    check_room(make_world(str(tmp_path / "inches.dae"), 1, start=(2.0, 2.5)), (2.0, 2.5))


def test_a_world_that_is_too_large_is_named_with_its_size(tmp_path: Path) -> None:
    write_dae(tmp_path / "wide.dae", room(), 1.0)
    with pytest.raises(InvalidInputError, match="is its unit right"):
        make_world(str(tmp_path / "wide.dae"), 1, start=(2.0, 2.5), unit=900.0)


def test_the_robot_starts_inside_with_room_and_stands(tmp_path: Path, description: str) -> None:
    file = write_stl(tmp_path / "room.stl", room())
    world = make_world(file, 1)
    assert min(look(world, 1.5)) > 0.7 and max(look(world, 1.5)) < WIDTH
    simulator = Simulator(build_scene(describe_scene(*scene_of(file, 1))), description)
    before = simulator.true_camera_pose().copy()
    simulator.step(2.0)
    np.testing.assert_allclose(simulator.true_camera_pose(), before, atol=0.02)


def test_walls_that_are_no_hull_are_touched_where_they_are(tmp_path: Path) -> None:
    """A ball dropped into the room falls to its floor and stays: the room is no solid block."""
    import mujoco

    world = make_world(write_stl(tmp_path / "room.stl", room()), 1, start=(2.0, 2.5))
    spec = world.spec.copy()
    ball = spec.worldbody.add_body(name="ball", pos=(1.0, -1.5, 1.0))
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    joint = int(model.body("ball").jntadr[0])
    data.qvel[int(model.jnt_dofadr[joint]) + 1] = -3.0  # against the wall at y = -2.5
    lowest = 9.0
    for _ in range(1500):
        mujoco.mj_step(model, data)
        lowest = min(lowest, float(data.xpos[model.body("ball").id, 1]))
    assert lowest == pytest.approx(-2.4, abs=0.03)
    assert float(data.xpos[model.body("ball").id, 2]) == pytest.approx(0.1, abs=0.02)


def write_plan(folder: Path, **more: object) -> str:
    """A hall of 10 x 6 m with a wall in it, as map_server writes it at 5 cm."""
    gray = np.full((140, 220), 205, np.uint8)  # unknown around
    gray[10:130, 10:210] = 254
    gray[8:10, 8:212] = gray[130:132, 8:212] = gray[8:132, 8:10] = gray[8:132, 210:212] = 0
    gray[10:60, 150:153] = 0  # rows count from the top: at large y
    cv2.imwrite(str(folder / "hall.pgm"), gray)
    told = {"image": "hall.pgm", "resolution": 0.05, "origin": "[-1.0, -2.0, 0]", "negate": 0}
    told |= {"occupied_thresh": 0.65, "free_thresh": 0.25} | more
    path = folder / "hall.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in told.items()))
    return str(path)


def test_a_floor_plan_stands_up(tmp_path: Path) -> None:
    world = make_world(write_plan(tmp_path), 1, start=(1.5, 3.5))
    ahead, left, behind, right = look(world, 1.2)
    # In the file the hall reaches from (-0.5, -1.5) to (9.5, 4.5), its inner wall from x = 6.5.
    np.testing.assert_allclose((ahead, behind), (6.5 - 1.5, 1.5 + 0.5), atol=1e-6)
    np.testing.assert_allclose((left, right), (4.5 - 3.5, 3.5 + 1.5), atol=1e-6)
    assert "11.0 x 7.0 m, walls of 1.5 m" in world.note
    assert look(make_world(write_plan(tmp_path), 1, start=(1.5, 0.5)), 1.2)[0] == pytest.approx(8.0)


@pytest.mark.parametrize("ending", [".bt", ".ot"])
@pytest.mark.parametrize("most", [10_000, 10])
def test_an_octree_stands_on_its_floor(
    tmp_path: Path, ending: str, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The room at 0.1 m, its floor at z = 1.1 m; with few boxes, in larger voxels."""
    monkeypatch.setattr(file_world, "_MOST_BOXES", most)
    full = np.indices((84, 64, 23)).reshape(3, -1).T
    wall = (full[:, :2] < 2).any(axis=1) | (full[:, 0] > 81) | (full[:, 1] > 61)
    inside = full[~wall & (full[:, 2] > 0)]
    solid = full[wall | (full[:, 2] == 0)]
    voxels = np.concatenate([solid, inside]) + np.array([-2, -2, 10])
    log_odds = np.where(np.arange(len(voxels)) < len(solid), 2.0, -2.0).astype(np.float32)
    config = SimpleNamespace(voxel_size=0.1)
    known = SimpleNamespace(config=config, voxels=lambda: (voxels.astype(np.int32), log_odds))
    path = tmp_path / f"room{ending}"
    (write_bt if ending == ".bt" else write_ot)(known, path)
    world = make_world(str(path), 1, start=(3.0, 2.0))
    np.testing.assert_allclose(look(world, 1.5), (WIDTH - 3.0, DEPTH - 2.0, 3.0, 2.0), atol=1e-3)
    above = np.array([[-3.1, 0.0, 4.0]])  # the wall behind
    down = world.surface.first_hits(above, above - (0.0, 0.0, 4.5))
    assert 4.0 - 4.5 * float(down[0]) == pytest.approx(2.2, abs=1e-3)
    assert "above its floor" in world.note


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("nothing.stl", None, "does not exist"),
        ("broken.stl", "solid\nendsolid\n", "broken.stl"),
        ("plan.yaml", "image: none.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n", "none.pgm"),
        ("other.yaml", "- 1\n", "no map_server file"),
        ("deep.yaml", "[" * 2000, "no map_server file"),
    ],
)
def test_what_cannot_be_read_is_named(
    tmp_path: Path, name: str, content: str | None, said: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InvalidInputError, match=said):
        make_world(str(tmp_path / name), 1)


def test_a_floor_without_anything_is_no_world(tmp_path: Path) -> None:
    file = write_stl(tmp_path / "floor.stl", box((0.0, 0.0, -0.1), (9.0, 9.0, 0.0))[2:4])
    with pytest.raises(InvalidInputError, match="nothing but a floor"):
        make_world(file, 1)


def test_a_name_that_is_none_lists_worlds_and_files() -> None:
    with pytest.raises(InvalidInputError, match=r"mars, office, cave; files: \.stl"):
        make_world("moon", 1)
    with pytest.raises((InvalidInputError, ConfigError)):
        make_world("mars", 1, up="y")
