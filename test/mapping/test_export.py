"""What leaves the map: point cloud files and the grid for planners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.ndimage import binary_dilation, convolve
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.export import (
    DistanceConfig,
    ProjectionConfig,
    height_colors,
    obstacle_distances,
    project_map,
    surface_sigmas,
    write_distances,
    write_grid,
    write_ply,
    write_stl,
)
from infomap_ros.mapping.voxels.state import information_of, put_states, unknown_states

from .test_distance_field import distance_to_cubes


@pytest.fixture(scope="module")
def wall_map() -> VoxelMap:
    """A wall at x = 2 m, seen along x from the origin, 1 cm of range error."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05, error_correlation=0.0))
    y, z = np.meshgrid(np.arange(-0.5, 0.5, 0.01), np.arange(0.0, 1.0, 0.01))
    points = np.stack([np.full(y.shape, 2.02), y, z], axis=-1).reshape(-1, 3)
    covariances = np.tile(np.diag([1e-4, 1e-6, 1e-6]), (len(points), 1, 1))
    voxel_map.integrate(points, np.eye(4), covariances, np.diag([4e-6] * 3 + [0.0] * 3))
    return voxel_map


def read_ply(path) -> tuple[list[str], np.ndarray]:
    """An independent reader: types and names as the header says."""
    header, _, data = path.read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    types = {"float": "<f4", "uchar": "u1"}
    fields = [line.split()[1:] for line in lines if line.startswith("property")]
    count = int(next(line for line in lines if line.startswith("element vertex")).split()[2])
    vertices = np.frombuffer(data, dtype=[(name, types[kind]) for kind, name in fields])
    assert len(vertices) == count
    return lines, vertices


def test_ply_holds_position_probability_and_sigma(wall_map, tmp_path):
    assert write_ply(wall_map, tmp_path / "a.ply") == wall_map.surface_voxels > 300
    lines, vertices = read_ply(tmp_path / "a.ply")
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    _, means, _ = wall_map.gaussians()
    for axis, name in enumerate("xyz"):
        np.testing.assert_allclose(vertices[name], means[:, axis], atol=1e-6)
    np.testing.assert_allclose(vertices["probability"], wall_map.probability(means), atol=1e-6)
    assert np.median(vertices["sigma"]) == pytest.approx(np.sqrt(4e-6 + 1e-4 / 25), rel=0.3)


def test_ply_of_an_empty_map_has_no_vertices(tmp_path):
    assert write_ply(VoxelMap(), tmp_path / "a.ply") == 0
    assert len(read_ply(tmp_path / "a.ply")[1]) == 0


def test_sigma_is_that_of_the_thinnest_direction(rng):
    turn, _ = np.linalg.qr(rng.normal(size=(5, 3, 3)))
    covariances = turn @ np.diag([0.04, 0.0009, 0.01]) @ turn.transpose(0, 2, 1)
    np.testing.assert_allclose(surface_sigmas(covariances), 0.03)


@pytest.mark.parametrize("widths", [(0.001, 0.03, 0.03), (0.001, 0.001, 0.03), (0.02, 0.02, 0.02)])
def test_sigma_is_the_smallest_of_any_direction(rng, widths):
    turns = Rotation.random(200, random_state=rng).as_matrix()
    covariances = turns @ np.diag(np.square(widths)) @ turns.transpose(0, 2, 1)
    np.testing.assert_allclose(surface_sigmas(covariances), min(widths), rtol=1e-5)


def test_colors_rise_in_lightness_with_height():
    colors = height_colors(np.linspace(-1.0, 3.0, 50)).astype(float)
    lightness = colors @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) >= 0.0).all()
    assert lightness[-1] - lightness[0] > 150
    assert len(height_colors(np.full(4, 2.0))) == 4


def column_map(columns: dict[tuple[int, int, int], float]) -> VoxelMap:
    """A map of these voxels with this evidence [nats]."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    indices = np.array(list(columns), dtype=np.int32).reshape(-1, 3)
    quanta = np.rint(np.array(list(columns.values())) / LOG_ODDS_QUANTUM).astype(np.int32)
    known = np.full(len(indices), True)
    put_states(voxel_map._storage, unknown_states(indices)._replace(known=known, quanta=quanta))
    return voxel_map


BAND = ProjectionConfig(low=0.2, high=0.5)  # voxels 2, 3 and 4 of 0.1 m


def test_projection_of_single_columns():
    voxel_map = column_map(
        {
            (-1, 4, 2): -3.0,  # free
            (0, 4, 2): -3.0,
            (0, 4, 4): 2.0,  # one occupied voxel in the column suffices
            (1, 4, 3): 0.0,  # undecided
            (1, 5, 1): 5.0,  # below the band
            (-1, 5, 5): 5.0,  # above the band
            (2, 6, 3): -3.0,
        }
    )
    grid = project_map(voxel_map, BAND)
    expected = [[0, 100, -1, -1], [-1, -1, -1, -1], [-1, -1, -1, 0]]
    np.testing.assert_array_equal(grid.cells, np.array(expected, dtype=np.int8), strict=True)
    np.testing.assert_allclose(grid.origin, (-0.1, 0.4))
    assert grid.resolution == 0.1


def test_projection_agrees_with_one_voxel_at_a_time(rng):
    indices = np.unique(rng.integers(-9, 9, size=(800, 3)), axis=0)
    columns = {
        tuple(i): v * LOG_ODDS_QUANTUM
        for i, v in zip(indices.tolist(), rng.integers(-16, 17, len(indices)).tolist(), strict=True)
    }
    grid = project_map(column_map(columns), BAND)
    for row, col in np.ndindex(grid.cells.shape):
        x, y = round(grid.origin[0] / 0.1) + col, round(grid.origin[1] / 0.1) + row
        chances = [1 / (1 + np.exp(-columns[x, y, z])) for z in (2, 3, 4) if (x, y, z) in columns]
        expected = -1
        if chances and max(chances) >= 0.65:
            expected = 100
        elif chances and max(chances) <= 0.25:
            expected = 0
        assert grid.cells[row, col] == expected


def test_wall_is_projected_to_a_line(wall_map):
    grid = project_map(wall_map, ProjectionConfig(low=0.1, high=0.8))
    rows, columns = np.nonzero(grid.cells == 100)
    x = grid.origin[0] + (columns + 0.5) * grid.resolution
    y = grid.origin[1] + (rows + 0.5) * grid.resolution
    assert set(np.round(x, 3)) == {2.025}
    assert y.min() < -0.4
    assert y.max() > 0.4
    assert (grid.cells == 0).any()


def test_nothing_in_the_band_is_one_unknown_cell(wall_map):
    grid = project_map(wall_map, ProjectionConfig(low=50.0, high=60.0))
    np.testing.assert_array_equal(grid.cells, [[-1]])
    assert project_map(VoxelMap()).cells.dtype == np.int8


@pytest.mark.parametrize(
    "change",
    [{"low": 1.0}, {"high": np.nan}, {"occupied_probability": 0.4}, {"free_probability": 0.6}],
)
def test_impossible_band_is_refused(change):
    with pytest.raises(ConfigError):
        replace(ProjectionConfig(), **change)


def read_stl(path) -> tuple[np.ndarray, np.ndarray]:
    """An independent reader of binary STL: normals (n, 3) and corners (n, 3, 3)."""
    content = path.read_bytes()
    count = int.from_bytes(content[80:84], "little")
    assert len(content) == 84 + 50 * count
    records = [content[84 + 50 * i : 132 + 50 * i] for i in range(count)]
    numbers = np.frombuffer(b"".join(records), "<f4").reshape(count, 4, 3).astype(np.float64)
    return numbers[:, 0], numbers[:, 1:]


def test_mesh_encloses_the_occupied_voxels(wall_map, tmp_path):
    assert write_stl(wall_map, tmp_path / "a.stl") > 1000
    normals, corners = read_stl(tmp_path / "a.stl")
    indices, log_odds = wall_map.voxels()
    occupied = {tuple(i) for i in indices[log_odds > 0.0].tolist()}
    # The volume under all triangles, by the theorem of Gauss: right where it is closed and turned.
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(len(occupied) * 0.05**3, rel=1e-4)
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(turned, normals * 0.05**2, atol=1e-7)
    middles = (corners.min(axis=1) + corners.max(axis=1)) / 2
    within = np.floor((middles - 0.5 * 0.05 * normals) / 0.05 + 1e-3).astype(int)
    beyond = np.floor((middles + 0.5 * 0.05 * normals) / 0.05 + 1e-3).astype(int)
    faces = {(tuple(a), tuple(b)) for a, b in zip(within.tolist(), beyond.tolist(), strict=True)}
    steps = [tuple(row) for row in np.vstack([np.eye(3, dtype=int), -np.eye(3, dtype=int)])]
    expected = {
        (voxel, beside)
        for voxel in occupied
        for step in steps
        if (beside := tuple(a + b for a, b in zip(voxel, step, strict=True))) not in occupied
    }
    assert faces == expected
    assert len(corners) == 2 * len(faces)


def test_mesh_of_an_empty_map_has_no_triangles(tmp_path):
    assert write_stl(VoxelMap(), tmp_path / "a.stl") == 0
    assert len(read_stl(tmp_path / "a.stl")[1]) == 0


def read_grid(path) -> tuple[np.ndarray, list[float], float]:
    """The rules of nav2_map_server, trinary: cells with rows from the lowest y, -1 for unknown."""
    told = yaml.safe_load(path.read_text())
    assert (told["mode"], told["negate"]) == ("trinary", 0)
    magic, size, most, data = (path.parent / told["image"]).read_bytes().split(b"\n", 3)
    assert (magic, most) == (b"P5", b"255")
    columns, rows = map(int, size.split())
    occupied = (255 - np.frombuffer(data, np.uint8).reshape(rows, columns)[::-1]) / 255
    cells = np.full((rows, columns), -1)
    cells[occupied > told["occupied_thresh"]] = 100
    cells[occupied < told["free_thresh"]] = 0
    return cells, told["origin"], told["resolution"]


def test_grid_is_read_by_the_rules_of_map_server(wall_map, tmp_path):
    band = ProjectionConfig(low=0.2, high=0.6)
    write_grid(wall_map, tmp_path / "a: b.yaml", band)
    cells, origin, resolution = read_grid(tmp_path / "a: b.yaml")
    assert resolution == 0.05
    assert origin[2] == 0.0
    assert set(np.unique(cells)) == {-1, 0, 100}
    indices, log_odds = wall_map.voxels()
    heights = (indices[:, 2] + 0.5) * 0.05
    in_band = (heights > 0.2) & (heights < 0.6)
    first = np.rint(np.array(origin[:2]) / 0.05).astype(int)
    for row, column in np.ndindex(*cells.shape):
        own = in_band & (indices[:, 0] == first[0] + column) & (indices[:, 1] == first[1] + row)
        highest = 1 / (1 + np.exp(-log_odds[own].max())) if own.any() else None
        expected = -1
        if highest is not None and highest >= band.occupied_probability:
            expected = 100
        elif highest is not None and highest <= band.free_probability:
            expected = 0
        assert cells[row, column] == expected


def test_distances_are_those_to_the_nearest_cube_that_is_not_free(tmp_path, rng):
    wall = np.stack([np.full(20000, 2.02), *rng.uniform(-0.5, 0.5, (2, 20000))], axis=-1)
    free_map = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    for y in (-0.1, 0.0, 0.1):  # seen through three times: free
        pose = np.eye(4)
        pose[1, 3] = y
        free_map.integrate(wall - pose[:3, 3], pose)
    shape = write_distances(free_map, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        distances, origin, size = file["distances"], file["origin"], float(file["voxel_size"])
    assert distances.shape == shape
    assert size == 0.05
    blocked = np.argwhere(distances == 0.0)
    clear = np.argwhere(distances > 0.0)
    assert len(clear) > 1000
    for place in clear[rng.permutation(len(clear))[:200]]:
        gap = np.maximum(np.abs(blocked - place) - 0.5, 0.0)
        edge = min(np.minimum(place, shape - place - 1)) + 0.5  # to what is outside
        nearest = min(np.linalg.norm(gap, axis=1).min(), edge) * size
        assert distances[tuple(place)] == pytest.approx(nearest, rel=1e-5)
    centers = origin + (clear + 0.5) * size
    assert (free_map.probability(centers)[free_map.is_known(centers)] <= 0.5).all()
    assert distances[tuple(np.floor(([2.02, 0.1, 0.2] - origin) / size).astype(int))] == 0.0
    assert distances[tuple(np.floor(([1.5, 0.1, 0.1] - origin) / size).astype(int))] > 0.2


def test_distances_of_an_empty_map_are_refused(tmp_path):
    with pytest.raises(InvalidInputError, match="is empty"):
        write_distances(VoxelMap(), tmp_path / "a.npz")
    assert list(tmp_path.iterdir()) == []


def within_two(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Which voxels have one of others no farther than two along each axis."""
    return cKDTree(others).query(places, p=np.inf)[0] < 2.5


def random_map(rng: np.random.Generator) -> tuple[VoxelMap, np.ndarray, np.ndarray, np.ndarray]:
    """A map of 0.1 m with unknown space within and around it.

    Returns:
        It, what is occupied and what is known of a larger box, and the box's first voxel.
    """
    first, shape = np.array((-17, -9, -16)), (46, 44, 38)
    observed, occupied = np.zeros((2, *shape), bool)
    observed[10:34, 12:32, 11:25] = True
    observed[18:25, 15:24, 14:22] = False  # unknown space with known space all around
    occupied[observed] = rng.random(np.count_nonzero(observed)) < 0.01
    places = np.argwhere(observed)
    odds = np.where(occupied[observed], 6.0, -4.0)
    voxels = (tuple(index) for index in (places + first).tolist())
    voxel_map = column_map(dict(zip(voxels, odds.tolist(), strict=True)))
    free, cube = observed & ~occupied, np.ones((3, 3, 3))
    mostly_free = convolve(free.astype(int), cube.astype(int), mode="constant") >= 13
    free |= ~observed & mostly_free & ~binary_dilation(occupied, cube)  # holes
    known = occupied | free
    unknown = np.argwhere(~known)
    nearby = [within_two(unknown, np.argwhere(kind)) for kind in (occupied, free)]
    known[tuple(unknown[nearby[0] & nearby[1]].T)] = True  # before a surface scans leave gaps
    return voxel_map, occupied, known, first


@pytest.mark.parametrize("unknown_is_free", [True, False])
@pytest.mark.parametrize("band", [None, ProjectionConfig(low=-0.5, high=0.1)])
def test_distances_to_obstacles_are_those_of_scipy(rng, band, unknown_is_free):
    voxel_map, occupied, known, first = random_map(rng)
    config = DistanceConfig(limit=0.45, unknown_is_free=unknown_is_free)
    blocked = occupied if unknown_is_free else occupied | ~known
    if band is not None:  # voxels -5 to 0 have their centers in it
        occupied, known = (a[..., 11:17].any(axis=2, keepdims=True) for a in (occupied, known))
        blocked = occupied if unknown_is_free else occupied | ~known
    distances = np.minimum(0.1 * distance_to_cubes(blocked), 0.45)
    rows = obstacle_distances(voxel_map, config, band)
    assert rows.dtype == np.float32
    places = np.rint(rows[:, :3] / 0.1 - 0.5 - first).astype(int)
    if band is not None:
        np.testing.assert_allclose(rows[:, 2], -0.2, atol=1e-6)
        places[:, 2] = 0
    np.testing.assert_allclose(
        rows[:, :2], (places[:, :2] + first[:2] + 0.5) * 0.1, atol=1e-5, err_msg="centers"
    )
    np.testing.assert_array_equal(np.argwhere(known), places)
    np.testing.assert_allclose(rows[:, 3], distances[known], atol=1e-5)
    assert {0.0, np.float32(0.45)} <= set(rows[:, 3]) or not unknown_is_free


def test_a_margin_of_sigmas_is_along_the_normal_and_no_wider_than_a_voxel_more(rng):
    indices = np.argwhere(np.ones((16, 16, 16), bool)).astype(np.int32)
    solid = np.flatnonzero((indices == (8, 8, 8)).all(1) | (indices == (3, 12, 5)).all(1))
    (normal, *sides) = Rotation.random(random_state=1).as_matrix().T  # of the first; no other has
    flat = 0.04**2 * np.outer(normal, normal) + sum(0.06**2 * np.outer(s, s) for s in sides)
    covariances = np.zeros((len(indices), 3, 3))
    covariances[solid] = flat, 0.05**2 * np.eye(3)
    means = (indices + rng.uniform(0.1, 0.9, indices.shape)) * 0.1
    voxel_map, is_solid = VoxelMap(VoxelMapConfig(voxel_size=0.1)), np.zeros(len(indices), bool)
    is_solid[solid] = True
    states = unknown_states(indices)._replace(
        known=np.ones(len(indices), bool),
        quanta=np.where(is_solid, 30, -20).astype(np.int32),
        information=information_of(indices, is_solid, means, covariances, 0.1),
    )
    put_states(voxel_map._storage, states)
    ball = rng.normal(size=(3000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    line = np.linspace(-1.0, 1.0, 101)[:, None] * normal
    for margin in (0.0, 1.0, 3.0):
        rows = obstacle_distances(voxel_map, DistanceConfig(margin=margin, limit=9.0))
        within = [means[solid[0]] + 0.04 * margin * line, means[solid[1]] + 0.05 * margin * ball]
        nearest = cKDTree(np.concatenate(within)).query(rows[:, :3])[0]
        assert (rows[:, 3] <= nearest + 1e-6).all()
        gaps = [
            np.maximum(points.min(axis=0) - rows[:, :3], rows[:, :3] - points.max(axis=0)) - 0.1
            for points in within
        ]
        least = np.linalg.norm(np.maximum(gaps, 0.0), axis=2).min(axis=0)
        assert (rows[:, 3] >= least - 2e-3).all()  # points of the ball are not everywhere
        np.testing.assert_allclose(nearest[rows[:, 3] == 0.0], 0.0, atol=0.1 * np.sqrt(3.0))


def test_distances_of_a_map_that_reaches_too_far_are_refused():
    voxel_map = column_map({(0, 0, 0): 6.0, (800, 800, 800): 6.0})
    with pytest.raises(InvalidInputError, match="is too large"):
        obstacle_distances(voxel_map)
    rows = obstacle_distances(voxel_map, band=ProjectionConfig(low=0.0, high=0.2))
    np.testing.assert_allclose(rows, [[0.05, 0.05, 0.1, 0.0]], atol=1e-6)


def test_distances_follow_the_map(rng):
    voxel_map, occupied, _, first = random_map(rng)
    empty = VoxelMap(voxel_map.config)
    assert obstacle_distances(empty).shape == (0, 4)
    assert obstacle_distances(voxel_map, band=ProjectionConfig(low=50.0, high=51.0)).shape == (0, 4)
    before = obstacle_distances(voxel_map)
    gone = (np.argwhere(occupied) + first).astype(np.int32)
    put_states(
        voxel_map._storage,
        unknown_states(gone)._replace(
            known=np.ones(len(gone), bool), quanta=np.full(len(gone), -20, np.int32)
        ),
    )
    after = obstacle_distances(voxel_map)
    assert (before[:, 3] == 0.0).sum() == len(gone)
    assert (after[:, 3] == np.float32(DistanceConfig().limit)).all()
