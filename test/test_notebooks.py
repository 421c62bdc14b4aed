"""The notebooks run as they stand there, and find what is true."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest

from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.planar.world import SensorConfig, level_pose, take_scan

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "docs/notebooks").glob("*.ipynb"))


def cells(notebook: Path) -> list[dict[str, Any]]:
    return list(json.loads(notebook.read_text("utf-8"))["cells"])


def run(name: str, folder: Path) -> dict[str, Any]:
    """Names that the code cells leave, run as a program of its own in a folder."""
    (notebook,) = [path for path in NOTEBOOKS if path.name == name]
    code = ["".join(cell["source"]) for cell in cells(notebook) if cell["cell_type"] == "code"]
    (folder / "notebook.py").write_text("\n\n".join(code), "utf-8")
    return runpy.run_path(str(folder / "notebook.py"), run_name="__main__")


@pytest.fixture(autouse=True)
def plots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    yield
    plt.close("all")


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_kept_without_outputs(notebook: Path) -> None:
    found = cells(notebook)
    assert found[0]["cell_type"] == "markdown"
    code = [cell for cell in found if cell["cell_type"] == "code"]
    assert len(code) >= 5
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    assert len({cell["id"] for cell in found}) == len(found)


def test_a_bag_is_mapped_and_the_map_is_as_wrong_as_it_says(tmp_path: Path) -> None:
    found = run("map_a_bag.ipynb", tmp_path)
    assert len(found["points"]) > 3000
    assert list(found["probability"].values()) == pytest.approx([0.0, 1.0, 0.5], abs=0.05)
    one, two, three = found["within"]
    assert one > 0.6 and two > 0.9 and three > 0.95
    assert np.isfinite(found["seen"].depth).mean() > 0.3


def test_the_own_strategy_explores_most_of_the_floor(tmp_path: Path) -> None:
    """The share mapped, against scans taken again at the views and counted here."""
    found = run("own_strategy.ipynb", tmp_path)
    world, sensor = found["world"], SensorConfig()
    views = {}
    for name, exploration in found["runs"].items():
        voxel_map = VoxelMap(sensor.map_config(world.cell))
        for x, y, azimuth in exploration.views:
            pose = level_pose(np.array([x, y]), azimuth, world.cell)
            take_scan(world.truth, sensor, pose, voxel_map)
        known = world.known_cells(voxel_map)[world.mappable]
        assert exploration.fraction[-1] == pytest.approx(known.mean(), abs=1e-12)
        assert known.mean() > 0.85
        views[name] = exploration.views
    own, usual = views.values()
    assert not np.array_equal(own, usual), "the class that was written chose"
