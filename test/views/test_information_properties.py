"""What Sujan and Dubowsky (2005) state of the new information of a view, for any scene."""

from __future__ import annotations

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMapConfig
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA
from infomap_ros.views.information.view_information import expected_information
from infomap_ros.views.information.view_query import InformationConfig

from .voxels import map_of

CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
GRID = VoxelMapConfig(voxel_size=0.2)
CONFIG = InformationConfig(ray_spacing=0.06, min_range=0.1)
RANGE = 2.0
SIDE = 32
"""Voxels along the map's edge; the camera is near its middle, all it sees lies in the map."""

EMPTY, SOLID = -20, 25
QUANTA = (UNKNOWN_QUANTA, EMPTY, -9, -4, 0, 2, 7, SOLID)

seeds = st.integers(0, 2**32 - 1)
quick = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))


def scene(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Random voxels in random proportions, and a pose among them."""
    share = rng.dirichlet(np.full(len(QUANTA), 0.4))
    quanta = rng.choice(QUANTA, (SIDE, SIDE, SIDE), p=share)
    rotation = Rotation.random(random_state=rng).as_matrix()
    return quanta, make_transform(rotation, rng.uniform(-0.5, 0.5, 3))


def bits(quanta: np.ndarray, pose: np.ndarray) -> float:
    m = map_of(quanta, (-SIDE // 2,) * 3, GRID)
    return float(expected_information(m, pose, CAMERA, RANGE, config=CONFIG)[0])


def some(rng: np.random.Generator, quanta: np.ndarray) -> np.ndarray:
    """A random part of the voxels."""
    return rng.random(quanta.shape) < rng.random()


@quick
@given(seeds)
def test_nothing_where_all_in_view_is_known_and_empty(seed: int) -> None:
    quanta, pose = scene(np.random.default_rng(seed))
    assert bits(np.full_like(quanta, EMPTY), pose) == 0.0


@quick
@given(seeds)
def test_falls_when_the_view_is_occluded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    quanta, pose = scene(rng)
    before = bits(quanta, pose)
    quanta[some(rng, quanta)] = SOLID
    assert bits(quanta, pose) <= before + 1e-9
    middle = np.abs(np.arange(SIDE) - SIDE // 2 + 0.5) < 7.0  # closed in on all sides
    shell = np.full_like(quanta, SOLID)
    shell[np.ix_(middle, middle, middle)] = EMPTY
    assert bits(shell, pose) == 0.0


@quick
@given(seeds)
def test_grows_with_the_number_of_unknowns(seed: int) -> None:
    rng = np.random.default_rng(seed)
    quanta, pose = scene(rng)
    quanta[quanta == UNKNOWN_QUANTA] = EMPTY
    before = bits(quanta, pose)
    for _ in range(3):
        quanta[some(rng, quanta) & (quanta == EMPTY)] = UNKNOWN_QUANTA
        after = bits(quanta, pose)
        assert after >= before - 1e-9
        before = after


@quick
@given(seeds, st.integers(1, 7))
def test_an_unknown_block_in_clear_view_counts(seed: int, edge: int) -> None:
    rng = np.random.default_rng(seed)
    quanta, pose = scene(rng)
    quanta[:] = EMPTY
    low = ((pose[:3, 3] + pose[:3, 2]) / GRID.voxel_size).astype(int) + SIDE // 2 - edge // 2
    block = tuple(slice(c, c + edge) for c in low)
    quanta[block] = UNKNOWN_QUANTA
    smaller = bits(quanta, pose)
    quanta[tuple(slice(c - 1, c + edge + 1) for c in low)] = UNKNOWN_QUANTA
    assert 0.0 < smaller < bits(quanta, pose)


@quick
@given(seeds)
def test_grows_where_known_voxels_are_nearer_to_one_half(seed: int) -> None:
    rng = np.random.default_rng(seed)
    quanta, pose = scene(rng)
    quanta[quanta == UNKNOWN_QUANTA] = -11  # all known
    before = bits(quanta, pose)
    nearer = some(rng, quanta)
    quanta[nearer] = np.trunc(quanta[nearer] * rng.random()).astype(int)
    assert bits(quanta, pose) >= before * (1.0 - 1e-6)


@quick
@given(seeds)
def test_uncertain_voxels_in_clear_view_tell_more_the_nearer_to_one_half(seed: int) -> None:
    quanta, pose = scene(np.random.default_rng(seed))
    told = [bits(np.full_like(quanta, q), pose) for q in (-20, -11, -8, -5, -2, 0)]
    assert told == sorted(told) and told[1] > 0.0 and told[-1] > 1.5 * told[1]
