"""OctoMap files against OctoMap itself (pyoctomap) and a real building."""

from __future__ import annotations

import errno
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyoctomap
import pytest

from infomap_ros.errors import CapacityError, InvalidInputError, MapFileError
from infomap_ros.mapping import FREE, OccupancyThresholds, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.octomap_file import (
    OctomapLeaves,
    binary_tree,
    full_tree,
    leaves_of_tree,
    read_octree,
    write_bt,
    write_ot,
)

SIZE = 0.1


def stand_in(indices: np.ndarray, log_odds: np.ndarray) -> SimpleNamespace:
    """What the writers ask of a map, with voxels of one's choice."""
    return SimpleNamespace(
        config=SimpleNamespace(voxel_size=SIZE),
        voxels=lambda: (np.int32(indices).reshape(-1, 3), np.float32(log_odds)),
    )


def random_map(rng: np.random.Generator, uniform: bool = False) -> SimpleNamespace:
    """Scattered voxels about the origin, and a solid block that prunes to large leaves."""
    scattered = np.unique(rng.integers(-40, 40, size=(3000, 3)), axis=0)
    scattered = scattered[(scattered < 0).any(axis=1) | (scattered >= 16).any(axis=1)]
    block = np.indices((16, 16, 16)).reshape(3, -1).T
    values = rng.integers(1, 20, size=len(scattered)) * rng.choice([-0.25, 0.25], len(scattered))
    indices = np.concatenate([scattered, block])
    log_odds = np.concatenate([values, np.full(len(block), -2.0)])
    order = rng.permutation(len(indices))
    return stand_in(indices[order], log_odds[order])


def read_by_octomap(path: Path) -> pyoctomap.OcTree:
    return pyoctomap.OcTree(1.0).read(str(path))


def value_at(tree: pyoctomap.OcTree, index: np.ndarray) -> float | None:
    node = tree.search((np.asarray(index) + 0.5) * SIZE)
    return None if node is None else float(node.getLogOdds())


def test_ot_is_read_by_octomap_with_every_log_odds(tmp_path, rng):
    chosen = random_map(rng)
    write_ot(chosen, tmp_path / "a.ot")
    tree = read_by_octomap(tmp_path / "a.ot")
    assert tree.getResolution() == SIZE
    indices, log_odds = chosen.voxels()
    np.testing.assert_array_equal([value_at(tree, i) for i in indices], log_odds)
    known = {tuple(i) for i in indices}
    beside = [i for i in rng.integers(-45, 45, size=(300, 3)) if tuple(i) not in known]
    assert [value_at(tree, i) for i in beside] == [None] * len(beside)


def test_bt_is_read_by_octomap_with_every_state(tmp_path, rng):
    chosen = random_map(rng)
    write_bt(chosen, tmp_path / "a.bt")
    tree = pyoctomap.OcTree(0.5)
    assert tree.readBinary(str(tmp_path / "a.bt"))
    assert tree.getResolution() == SIZE
    indices, log_odds = chosen.voxels()
    occupied = [value_at(tree, i) > 0.0 for i in indices]
    np.testing.assert_array_equal(occupied, log_odds > 0.0)
    assert sum(edge**3 for edge in read_octree(tmp_path / "a.bt").edges) == len(indices)


def test_equal_voxels_are_pruned_as_octomap_does(tmp_path, rng):
    chosen = random_map(rng)
    write_ot(chosen, tmp_path / "a.ot")
    write_bt(chosen, tmp_path / "a.bt")
    full = read_by_octomap(tmp_path / "a.ot")
    assert full.size() == full.calcNumNodes()
    binary = pyoctomap.OcTree(0.5)
    binary.readBinary(str(tmp_path / "a.bt"))
    full.toMaxLikelihood()
    full.writeBinary(str(tmp_path / "b.bt"))
    again = pyoctomap.OcTree(0.5)
    again.readBinary(str(tmp_path / "b.bt"))
    assert again.size() == binary.size()
    assert 16 in read_octree(tmp_path / "a.bt").edges


def test_bt_round_trip(tmp_path, rng):
    chosen = random_map(rng)
    write_bt(chosen, tmp_path / "a.bt")
    leaves = read_octree(tmp_path / "a.bt")
    indices, log_odds = chosen.voxels()
    expected = {tuple(i) for i in indices[log_odds > 0.0].tolist()}
    voxels = leaves.occupied_voxels()
    assert leaves.resolution == SIZE
    assert {tuple(i) for i in voxels.tolist()} == expected
    assert len(voxels) == len(expected)


def test_octomaps_own_bt_is_read(tmp_path, rng):
    tree = pyoctomap.OcTree(0.25)
    places = rng.uniform(-5, 5, size=(500, 3))
    occupied = rng.random(500) < 0.5
    for place, hit in zip(places, occupied, strict=True):
        tree.updateNode(place, bool(hit))
    tree.writeBinary(str(tmp_path / "a.bt"))
    leaves = read_octree(tmp_path / "a.bt")
    expected = {
        tuple(np.floor(np.array(leaf.getCoordinate()) / 0.25).astype(int))
        for leaf in tree.begin_leafs()
        if tree.isNodeOccupied(leaf)
    }
    assert expected
    assert {tuple(i) for i in leaves.occupied_voxels().tolist()} == expected


def test_real_building_has_as_many_leaves_as_octomap_finds(real_data):
    path = real_data / "octomaps" / "geb079.bt"
    tree = pyoctomap.OcTree(0.5)
    tree.readBinary(str(path))
    leaves = read_octree(path)
    assert len(leaves.edges) == tree.getNumLeafNodes()
    low, high = leaves.corners.min(axis=0), (leaves.corners + leaves.edges[:, None]).max(axis=0)
    np.testing.assert_allclose(low * leaves.resolution, tree.getMetricMin(), atol=1e-9)
    np.testing.assert_allclose(high * leaves.resolution, tree.getMetricMax(), atol=1e-9)


def test_empty_map_makes_files_that_octomap_reads(tmp_path):
    empty = VoxelMap(VoxelMapConfig(voxel_size=SIZE))
    write_bt(empty, tmp_path / "a.bt")
    write_ot(empty, tmp_path / "a.ot")
    tree = pyoctomap.OcTree(0.5)
    assert tree.readBinary(str(tmp_path / "a.bt"))
    assert tree.size() == 0
    assert read_by_octomap(tmp_path / "a.ot").size() == 0
    assert len(read_octree(tmp_path / "a.bt").edges) == 0


def test_integrated_scan_reaches_octomap(tmp_path):
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE))
    wall = np.stack(
        [*np.meshgrid(np.arange(-1, 1, 0.02), np.arange(-1, 1, 0.02)), np.full((100, 100), 2.05)],
        -1,
    )
    voxel_map.integrate(wall.reshape(-1, 3), np.eye(4))
    write_ot(voxel_map, tmp_path / "a.ot")
    tree = read_by_octomap(tmp_path / "a.ot")
    places = np.array([[0.05, 0.05, 2.05], [0.05, 0.05, 1.05]])
    read = [tree.search(place).getLogOdds() for place in places]
    np.testing.assert_allclose(read, voxel_map.log_odds(places))
    assert read[0] > 0.0 > read[1]


@pytest.mark.parametrize("index", [[0, 0, 2**15], [-(2**15) - 1, 0, 0]])
def test_voxel_beyond_octomaps_limit_is_refused(tmp_path, index):
    for write in (write_bt, write_ot):
        with pytest.raises(InvalidInputError, match="32768"):
            write(stand_in(np.array([index]), np.array([1.0])), tmp_path / "a")


def test_voxels_at_octomaps_limit_are_kept(tmp_path):
    corners = np.array([[2**15 - 1] * 3, [-(2**15)] * 3])
    write_bt(stand_in(corners, np.array([1.0, 2.0])), tmp_path / "a.bt")
    voxels = read_octree(tmp_path / "a.bt").occupied_voxels()
    np.testing.assert_array_equal(np.sort(voxels, axis=0), np.sort(corners, axis=0))


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lambda content: content[:-40], "truncated"),
        (lambda content: content.replace(b"id OcTree", b"id ColorOcTree"), "OcTree"),
        (lambda content: content.replace(b"res 0.1", b"res -1"), "OcTree"),
        (lambda content: content.replace(b"size ", b"size 9"), "header says"),
        (lambda content: b"# Octomap OcTree file" + content, "no OctoMap"),
        (lambda content: content.replace(b"data\n", b"data\n" + b"\xff" * 80), "levels"),
        (lambda content: b"", "no OctoMap"),
    ],
)
def test_damaged_bt_is_refused_by_name(tmp_path, rng, damage, named):
    write_bt(random_map(rng), tmp_path / "a.bt")
    (tmp_path / "b.bt").write_bytes(damage((tmp_path / "a.bt").read_bytes()))
    with pytest.raises(MapFileError, match=rf"b\.bt.*{named}"):
        read_octree(tmp_path / "b.bt")


def test_a_file_that_fits_nowhere_is_not_taken_apart(tmp_path):
    head = b"# Octomap OcTree binary file\nid OcTree\nsize 9\nres 0.1\ndata\n"
    (tmp_path / "a.bt").write_bytes(head + b"\xaa\xaa")  # eight occupied leaves below the root
    leaves = read_octree(tmp_path / "a.bt")
    with pytest.raises(CapacityError, match="281474976710656 occupied voxels"):
        leaves.occupied_voxels()
    for res in (b"inf", b"nan", b"1e300"):
        (tmp_path / "a.bt").write_bytes(head.replace(b"0.1", res) + b"\xaa\xaa")
        with pytest.raises(MapFileError, match=r"a\.bt"):
            read_octree(tmp_path / "a.bt")


@pytest.mark.parametrize("write", [write_bt, write_ot])
def test_what_cannot_be_written_leaves_the_old_file(tmp_path, rng, write, monkeypatch):
    path = tmp_path / "a.bt"
    write(random_map(rng), path)
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write(random_map(rng), path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["a.bt"]


def test_missing_file_is_named(tmp_path):
    with pytest.raises(MapFileError, match=r"none\.bt: No such file"):
        read_octree(Path(tmp_path / "none.bt"))


def test_ot_and_bt_have_the_same_leaves_as_voxels(tmp_path, rng):
    chosen = random_map(rng)
    write_ot(chosen, tmp_path / "a.ot")
    write_bt(chosen, tmp_path / "a.bt")
    full, binary = (read_octree(tmp_path / name) for name in ("a.ot", "a.bt"))
    voxels = [sorted(map(tuple, one.occupied_voxels().tolist())) for one in (full, binary)]
    assert voxels[0] == voxels[1]
    sizes = [int((one.edges.astype(np.int64) ** 3).sum()) for one in (full, binary)]
    assert sizes == [len(chosen.voxels()[0])] * 2


def test_a_damaged_ot_is_refused(tmp_path, rng):
    write_ot(random_map(rng), tmp_path / "a.ot")
    whole = (tmp_path / "a.ot").read_bytes()
    (tmp_path / "a.ot").write_bytes(whole[:-7])
    with pytest.raises(MapFileError, match="nodes"):
        read_octree(tmp_path / "a.ot")
    start = whole.index(b"data\n") + 5
    (tmp_path / "a.ot").write_bytes(whole[:start] + b"\xff" * (len(whole) - start))
    with pytest.raises(MapFileError, match=r"truncated|beside|levels"):
        read_octree(tmp_path / "a.ot")


def tree_data(path: Path) -> bytes:
    """What a message holds of a file."""
    return path.read_bytes().partition(b"\ndata\n")[2]


def wall_map() -> VoxelMap:
    """A wall that two scans saw, and the free space before it; the floor is unknown."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE))
    y, z = np.meshgrid(np.arange(-1.0, 1.0, 0.02), np.arange(-1.0, 1.0, 0.02))
    for shift in (0.0, 0.2):
        wall = np.stack([np.full(y.shape, 2.03 - shift), y, z], -1).reshape(-1, 3)
        pose = np.eye(4)
        pose[0, 3] = shift
        voxel_map.integrate(wall, pose)
    return voxel_map


def test_a_map_comes_back_from_its_tree_with_every_probability() -> None:
    known = wall_map()
    tree = full_tree(known)
    back = leaves_of_tree(tree.data, SIZE, binary=False).voxel_map(0.05, 1.0)
    indices, log_odds = known.voxels()
    centers = (indices + 0.5) * SIZE
    assert back.known_voxels == known.known_voxels
    np.testing.assert_allclose(back.probability(centers), known.probability(centers), rtol=1e-12)
    assert len(np.unique(log_odds)) > 3
    outside = centers + np.array((0.0, 0.0, 9.0))
    assert not back.is_known(outside).any()


def test_a_surface_may_be_anywhere_in_its_voxel() -> None:
    known = wall_map()
    leaves = leaves_of_tree(full_tree(known).data, SIZE, binary=False)
    indices, means, covariances = leaves.voxel_map(0.12, 1.0).gaussians()
    every, log_odds = known.voxels()
    assert {tuple(i) for i in indices} == {tuple(i) for i in every[log_odds > 0.0]}
    np.testing.assert_allclose(means, (indices + 0.5) * SIZE, atol=1e-6)
    uniform = SIZE**2 / 12.0 * np.eye(3)
    np.testing.assert_allclose(covariances, np.tile(uniform, (len(indices), 1, 1)), rtol=1e-5)


@pytest.mark.parametrize("binary", [False, True])
def test_what_octomap_has_clamped_is_free_and_occupied(tmp_path, binary) -> None:
    """By its own sensor model and limits, -2 to 3.5: nothing there is below 0.05."""
    tree, places = pyoctomap.OcTree(SIZE), (np.indices((20, 20, 20)).reshape(3, -1).T + 0.5) * SIZE
    is_wall = places[:, 0] > 1.9
    for _ in range(9):
        for place, hit in zip(places, is_wall, strict=True):
            tree.updateNode(place, bool(hit))
    once = np.array([0.05, 0.05, 5.05])  # seen once, and then no more
    tree.updateNode(once, False)
    (tree.writeBinary if binary else tree.write)(str(tmp_path / "a"))
    leaves = leaves_of_tree(tree_data(tmp_path / "a"), SIZE, binary=binary)
    assert leaves.edges.max() >= 8
    assert -2.001 <= leaves.log_odds.min() < leaves.log_odds.max() <= 3.512  # 0.1192 and 0.971
    found = leaves.voxel_map(0.12, 1.0)
    assert found.known_voxels == len(places) + 1
    np.testing.assert_array_equal(found.probability(places) > 0.95, is_wall)
    np.testing.assert_array_equal(found.probability(places) < 0.05, ~is_wall)
    states = found.window((0.0, 0.0, 0.0), (1.85, 1.95, 1.95)).states(OccupancyThresholds())
    assert (states == FREE).all()
    assert binary or found.probability(once[None])[0] == pytest.approx(0.4, abs=0.03)
    stricter = leaves.voxel_map(0.1, 1.0).probability(places[~is_wall])
    np.testing.assert_allclose(stricter, 0.12, atol=0.001)


def test_log_odds_are_those_of_octomap_within_half_a_quantum(tmp_path, rng) -> None:
    tree, index = pyoctomap.OcTree(SIZE), rng.integers(-40, 40, size=(400, 3))
    for _ in range(6):
        for place, hit in zip((index + 0.5) * SIZE, rng.random(len(index)) < 0.6, strict=True):
            tree.updateNode(place, bool(hit))
    tree.write(str(tmp_path / "a.ot"))
    found = leaves_of_tree(tree_data(tmp_path / "a.ot"), SIZE, binary=False).voxel_map(0.05, 1.0)
    expected = [value_at(tree, i) for i in index]
    np.testing.assert_allclose(found.log_odds((index + 0.5) * SIZE), expected, atol=0.1251)


@pytest.mark.parametrize("write", [full_tree, binary_tree])
def test_a_damaged_tree_is_refused(write) -> None:
    data, binary = write(wall_map()).data, write is binary_tree
    for odd, problem in (
        (data[:-1], "truncated"),
        (data[:-10], "truncated"),
        (data + data[:10], "beside"),
        (b"\xff" * len(data), "truncated|levels"),
    ):
        with pytest.raises(InvalidInputError, match=problem):
            leaves_of_tree(odd, SIZE, binary=binary)
    for size in (0.0, -0.1, np.nan, np.inf, 1e3):
        with pytest.raises(InvalidInputError, match="voxels of"):
            leaves_of_tree(data, size, binary=binary)
    assert len(leaves_of_tree(b"", SIZE, binary=binary).edges) == 0


def test_log_odds_that_are_not_finite_are_refused() -> None:
    data = bytearray(full_tree(wall_map()).data)
    data[-5:-1] = np.float32(np.nan).tobytes()  # of the last leaf
    with pytest.raises(InvalidInputError, match="finite"):
        leaves_of_tree(bytes(data), SIZE, binary=False)


def test_a_tree_that_fits_nowhere_is_not_taken_apart() -> None:
    with pytest.raises(CapacityError, match="281474976710656 voxels"):
        leaves_of_tree(b"\xaa\xaa", SIZE, binary=True)
    corner, edge, free = np.zeros((1, 3), np.int32), np.int32([256]), np.float32([-2.0])
    with pytest.raises(CapacityError, match="limit"):
        OctomapLeaves(SIZE, corner, edge, free).voxel_map(0.12, 0.001)
