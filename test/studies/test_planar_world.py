"""Planar worlds, their scans, and the fraction mapped, against brute force."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.planar.tasks import read_floor_plan
from infomap_ros.studies.planar.world import (
    KINDS,
    PlanarWorld,
    SensorConfig,
    level_pose,
    make_world,
    take_scan,
)


def cell_world(rows: list[str], start: tuple[float, float]) -> PlanarWorld:
    """A world from a drawing, 1 m a character, the first row at the top."""
    occupied = np.array([[letter == "#" for letter in row] for row in rows[::-1]]).T
    return PlanarWorld("drawn", "drawn", occupied, 1.0, np.array(start))


def walk(world: PlanarWorld, place: np.ndarray, angle: float, reach: float) -> set[tuple[int, int]]:
    """Cells that a ray meets, by tiny steps, up to the first occupied one."""
    met = set()
    for r in np.arange(0.0, reach, 2e-4):
        i, j = np.floor((place + r * np.array([np.cos(angle), np.sin(angle)])) / world.cell)
        met.add((int(i), int(j)))
        if world.occupied[int(i), int(j)]:
            break
    return met


DRAWING = [
    "##########",
    "#   #    #",
    "#   #  # #",
    "#   #    #",
    "#        #",
    "##########",
]


def test_a_scan_maps_what_its_rays_meet() -> None:
    world = cell_world(DRAWING, (2.5, 2.5))
    sensor = SensorConfig(field_of_view=60.0, max_range=6.0, ray_spacing=0.05)
    voxel_map = VoxelMap(sensor.map_config(1.0))
    place, azimuth = np.array([2.5, 2.5]), 0.23
    take_scan(world.truth, sensor, level_pose(place, azimuth, 1.0), voxel_map)
    half = np.tan(np.radians(30.0))
    edges = np.arctan(np.linspace(-half, half, int(np.ceil(2.0 * half / 0.05)) + 1))
    angles = azimuth + 0.5 * (edges[1:] + edges[:-1])
    met = set[tuple[int, int]]().union(*(walk(world, place, a, 5.99) for a in angles))
    known = {(int(i), int(j)) for i, j in np.argwhere(world.known_cells(voxel_map))}
    assert len(met & known) >= 0.95 * len(met | known)  # far rays that end in a cell share one
    probability = voxel_map.probability(np.array([(i + 0.5, j + 0.5, 0.5) for i, j in known]))
    expected = [world.occupied[i, j] for i, j in known]
    np.testing.assert_array_equal(probability > 0.5, expected)
    assert ((probability < 0.05) | (probability > 0.95)).all()  # one look makes them certain


def test_fraction_mapped_counts_what_can_be_reached() -> None:
    walled_in = [*DRAWING[:1], "#   ######", "#   #    #", "#   ######", *DRAWING[4:]]
    world = cell_world(walled_in, (2.5, 2.5))
    seen = VoxelMap(SensorConfig().map_config(1.0))
    assert world.fraction_mapped(seen) == 0.0
    free = {(2, 2)}
    while True:  # flood by hand
        more = {
            (i + a, j + b)
            for i, j in free
            for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))
            if not world.occupied[i + a, j + b]
        }
        if more <= free:
            break
        free |= more
    walls = {
        (i + a, j + b)
        for i, j in free
        for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))
        if world.occupied[i + a, j + b]
    }
    assert {(int(i), int(j)) for i, j in np.argwhere(world.mappable)} == free | walls
    assert (6, 3) not in free and not world.occupied[6, 3]  # the closed room does not count
    sensor = SensorConfig(field_of_view=90.0, max_range=8.0)
    take_scan(world.truth, sensor, level_pose(np.array([2.5, 2.5]), 0.0, 1.0), seen)
    known = {(int(i), int(j)) for i, j in np.argwhere(world.known_cells(seen))}
    share = len(known & (free | walls)) / len(free | walls)
    assert world.fraction_mapped(seen) == pytest.approx(share)
    assert 0.2 < share < 0.9


@pytest.mark.parametrize("kind", list(KINDS))
def test_worlds_are_seeded_and_can_be_entered(kind: str) -> None:
    world, same = make_world(kind, 3, 1.0), make_world(kind, 3, 1.0)
    np.testing.assert_array_equal(world.occupied, same.occupied)
    assert not np.array_equal(world.occupied, make_world(kind, 4, 1.0).occupied)
    assert world.occupied.shape == (102, 102)
    assert np.hypot(*(world.start - 51.0)) < 1.0
    assert (world.mappable & ~world.occupied).mean() > 0.35


def test_unknown_kind_is_refused() -> None:
    with pytest.raises(ConfigError, match="kind"):
        make_world("jungle", 0)


def test_open_borders_and_starts_in_walls_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="border"):
        cell_world(["###", "# #", "# #"], (1.5, 1.5))
    with pytest.raises(InvalidInputError, match="obstacle"):
        cell_world(DRAWING, (4.5, 3.5))


def test_floor_plan_keeps_walls_and_doors(tmp_path: Path) -> None:
    image = np.full((200, 100), 254, np.uint8)
    image[:4], image[-4:], image[:, :4], image[:, -4:] = 0, 0, 0, 0
    image[98:102] = 0
    image[98:102, 40:60] = 254  # a door
    cv2.imwrite(str(tmp_path / "plan.pgm"), image)
    text = "image: plan.pgm\nresolution: 0.05\nnegate: 0\nfree_thresh: 0.25\n"
    (tmp_path / "plan.yaml").write_text(text)
    world = read_floor_plan(tmp_path / "plan.yaml", cell=1.0, side=50.0)
    assert world.name == "plan"
    assert world.occupied.shape == (25, 52)
    assert world.mappable[:, 30:].any() and world.mappable[:, :20].any()  # both sides of the wall
    middle = world.occupied[:, 25] | world.occupied[:, 26]
    assert middle[:9].all() and middle[-8:].all() and not middle[13]


def test_missing_floor_plans_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"none\.yaml"):
        read_floor_plan(tmp_path / "none.yaml")
    (tmp_path / "plan.yaml").write_text("resolution: 0.05\n")
    with pytest.raises(InvalidInputError, match="image"):
        read_floor_plan(tmp_path / "plan.yaml")
