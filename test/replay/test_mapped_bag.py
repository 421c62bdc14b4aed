"""The README's lines of Python run as they are printed, and say what they made."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import infomap_ros
from infomap_ros.errors import ConfigError
from infomap_ros.mapping import VoxelMap

from .scenes import WALL, depth_frames, write

REPOSITORY = Path(__file__).resolve().parents[2]


def test_readme_runs_as_printed(tmp_path, monkeypatch, capsys):
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    (lines,) = re.findall(r"\n\n((?:    .*\n|\n)*    import infomap_ros\n(?:    .*\n|\n)+)", text)
    (tmp_path / "bags").symlink_to(REPOSITORY / "bags")
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {}
    exec(re.sub(r"^    ", "", lines, flags=re.MULTILINE), scope)
    printed = capsys.readouterr().out
    assert printed.startswith("MappedBag('rover_rocks', 34 frames, VoxelMap(voxel_size=0.1, ")
    assert np.shape(scope["points"])[1:] == (3,)
    assert np.shape(scope["covariances"])[1:] == (3, 3)
    assert (tmp_path / "rocks.png").stat().st_size > 10_000


def test_map_bag_gives_map_path_and_summary(tmp_path):
    bag = write(tmp_path / "bag", depth_frames())
    mapped = infomap_ros.map_bag(bag, voxel_size=0.1, out=tmp_path / "out")
    assert mapped.summary["frames"] == 6
    np.testing.assert_allclose(mapped.camera_path[:, 0], 0.1 * np.arange(6), atol=1e-9)
    points, covariances = mapped.surface()
    assert abs(np.median(points[:, 0]) - WALL) < 0.02
    assert (np.linalg.eigvalsh(covariances) > 0.0).all()
    near, behind = mapped.probability([[1.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    assert near < 0.1
    assert behind == 0.5
    assert VoxelMap.load(tmp_path / "out" / "map.infomap").known_voxels == mapped.map.known_voxels


def test_show_opens_the_page(tmp_path, monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    page = infomap_ros.map_bag(write(tmp_path / "bag", depth_frames())).show()
    assert opened == [page.as_uri()]
    assert "path of the camera" in page.read_text(encoding="utf-8")


def test_impossible_sizes_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="voxel_size"):
        infomap_ros.map_bag(tmp_path, voxel_size=-1.0)


def test_what_there_is_not_is_no_attribute():
    with pytest.raises(AttributeError, match="map_bags"):
        infomap_ros.__getattr__("map_bags")
