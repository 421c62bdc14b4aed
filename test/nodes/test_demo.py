"""The demo, without its processes: the first picture of its map, and Ctrl-C."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from rich.console import Console
from rich.status import Status

from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.nodes.live.demo import FirstPicture, follow_to_the_end


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


class Interrupted:
    """An exploration during which Ctrl-C is pressed so many times."""

    def __init__(self, times: int) -> None:
        self.times, self.calls, self.figures = times, list[str](), dict[str, str]()

    def follow(self, tick: Any, timeout: float) -> None:
        self.calls.append("follow")
        if self.times:
            self.times -= 1
            raise KeyboardInterrupt

    def call(self, service: str) -> None:
        self.calls.append(service)


def follow(run: Interrupted) -> bool:
    console = Console(quiet=True)
    return follow_to_the_end(cast("Any", run), Status("", console=console), console, 1.0)


def test_ctrl_c_stops_the_exploration_whose_results_follow() -> None:
    undisturbed, once, twice = (Interrupted(times) for times in range(3))
    assert not follow(undisturbed) and undisturbed.calls == ["follow"]
    assert follow(once) and once.calls == ["follow", "explorer/stop", "follow"]
    with pytest.raises(KeyboardInterrupt):
        follow(twice)
