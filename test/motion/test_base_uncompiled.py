"""Stances and paths of the base mean the same in plain Python."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from infomap_ros.motion.base.base_planner import BasePlanner

from .grounds import ground, rough, rover

SCRIPT = """
import sys
sys.path.insert(0, sys.argv[2])
from numba import config
from motion.test_base_uncompiled import answers
import numpy as np

assert config.DISABLE_JIT
np.savez(sys.argv[1], **answers())
"""


def answers() -> dict[str, np.ndarray]:
    """Stances on rough ground, and a way over it in coarse cells."""
    rng = np.random.default_rng(11)
    vehicle = rover()
    terrain = ground(rough(rng, 0.12), 1.2)
    places = rng.uniform((-0.8, -0.8, -3.0), (0.8, 0.8, 3.0), (60, 3))
    batch = vehicle.stances(terrain, places)
    planner = BasePlanner(ground(rough(rng, 0.002), 0.8, cell=0.1), vehicle)
    path = planner.plan((0.0, 0.0, 0.0), (0.2, 0.1, 1.0), samples=0)
    return {
        "outcomes": batch.outcomes,
        "measures": batch.measures,
        "poses": batch.T_map_base,
        "area": planner.reachable_area((0.0, 0.0, 0.0)),
        "path": path.poses,
    }


def test_kernels_do_the_same_uncompiled(tmp_path):
    found = tmp_path / "found.npz"
    subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SCRIPT, found, Path(__file__).parents[1]],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        check=True,
        timeout=120,
    )
    expected = answers()
    assert len(np.unique(expected["outcomes"])) > 2
    assert expected["area"].any() and len(expected["path"]) > 3
    for name, value in np.load(found).items():
        np.testing.assert_allclose(value, expected[name], atol=1e-6, err_msg=name)
