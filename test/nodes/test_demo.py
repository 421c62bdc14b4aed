"""The demo, without its processes: the first picture of its map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.nodes.live.demo import FirstPicture


def test_the_first_map_with_a_surface_is_drawn_once(tmp_path: Path) -> None:
    map_file, path = tmp_path / "map.infomap", tmp_path / "map.png"
    picture = FirstPicture(map_file, path)
    assert not picture.draw()

    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    voxel_map.save(map_file)
    assert not picture.draw()
    assert picture.seconds is None and not path.exists()

    wall = np.random.default_rng(0).uniform((1.0, -0.5, -0.5), (1.05, 0.5, 0.5), (500, 3))
    voxel_map.integrate(wall, np.eye(4))
    voxel_map.save(map_file)
    assert picture.draw()
    assert picture.seconds is not None
    assert path.read_bytes().startswith(b"\x89PNG")

    path.unlink()
    voxel_map.save(map_file)
    assert not picture.draw()
    assert not path.exists()
