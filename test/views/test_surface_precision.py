"""What views tell about where surfaces lie."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import Box, PinholeCamera, PlacedSolid, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.export import surface_sigmas
from infomap_ros.views.information.field import CodeBook
from infomap_ros.views.information.gains import surface_bits
from infomap_ros.views.information.view_information import expected_information, view_gains
from infomap_ros.views.information.view_query import InformationConfig

from . import naive
from .rooms import box_points, facing

CAMERA = PinholeCamera(64, 48, 40.0, 40.0, 31.5, 23.5)
ROOM = (6.0, 4.0, 2.5)


@pytest.fixture(scope="module")
def room() -> VoxelMap:
    """A room seen from its middle with coarse range noise."""
    m = VoxelMap(VoxelMapConfig(voxel_size=0.1, default_sigma=0.06))
    for n in range(8):
        pose = facing(n * math.pi / 4.0, (3.0, 2.0, 1.2))
        for _ in range(2):
            m.integrate(box_points(CAMERA, pose, ROOM), pose, camera=CAMERA)
    return m


def gained(m: VoxelMap, pose: np.ndarray, config: InformationConfig) -> float:
    """Bits about surfaces alone."""
    without = InformationConfig(**{**vars(config), "wanted_sigma": 0.0})
    with_surfaces, occupancy = (
        float(expected_information(m, pose, CAMERA, 4.0, config=c)[0]) for c in (config, without)
    )
    return with_surfaces - occupancy


def naive_gain(m: VoxelMap, pose: np.ndarray, config: InformationConfig) -> float:
    """The same, step by step along rays."""
    size, total = m.config.voxel_size, 0.0
    indices, _, covariances = m.gaussians()
    sigma_of = dict(zip(map(tuple, indices.tolist()), surface_sigmas(covariances), strict=True))
    for direction, angle in naive.image_cells(CAMERA, config.ray_spacing):
        visible, steps = 1.0, 64
        for n in range(steps):
            length = 4.0 / steps
            r = (n + 0.5) * length
            point = (pose[:3, 3] + r * (pose[:3, :3] @ direction))[None]
            sigma = sigma_of.get(tuple(np.floor(point[0] / size).astype(int)))
            if sigma is not None and r >= config.min_range:
                volume = angle * (((n + 1) * length) ** 3 - (n * length) ** 3) / 3.0 / size**3
                pixels = (size / (config.pixel_angle * r)) ** 2
                c = m.config.error_correlation
                noise = config.range_noise * r * r * math.sqrt(c + (1.0 - c) / max(pixels, 1.0))
                after = 1.0 / math.sqrt(1.0 / sigma**2 + 1.0 / noise**2)
                wanted = config.wanted_sigma
                bits = math.log2(max(sigma, wanted) / max(after, wanted))
                total += visible * volume * bits * min(1.0, pixels)
            known, log_odds = bool(m.is_known(point)[0]), float(m.log_odds(point)[0])
            visible *= naive.clear_share(known, log_odds, length / size, config)
            if visible < config.min_visibility:
                break
    return total


def test_agrees_with_a_naive_sum(room: VoxelMap) -> None:
    """As far as levels of standard deviation allow."""
    config = InformationConfig(ray_spacing=0.06, wanted_sigma=0.002)
    for azimuth, place in ((0.3, (2.0, 1.5, 1.0)), (2.0, (4.0, 1.0, 1.4))):
        pose = facing(azimuth, place)
        expected = naive_gain(room, pose, config)
        assert expected > 50.0
        assert gained(room, pose, config) == pytest.approx(expected, rel=0.04)


def test_nothing_where_surfaces_are_precise_enough(room: VoxelMap) -> None:
    largest = surface_sigmas(room.gaussians()[2]).max()
    pose = facing(0.3, (2.0, 1.5, 1.0))
    assert gained(room, pose, InformationConfig(wanted_sigma=float(largest))) == 0.0
    told = [gained(room, pose, InformationConfig(wanted_sigma=w)) for w in (0.018, 0.024, 0.03)]
    assert told[0] > told[1] > told[2] > 0.0
    finer = gained(room, pose, InformationConfig(wanted_sigma=0.002))
    assert finer == pytest.approx(  # of what one view cannot reach, as far as levels of sigma allow
        gained(room, pose, InformationConfig(wanted_sigma=0.01)), rel=0.01
    )


def test_a_near_look_tells_more_of_each_surface_than_a_far_glance() -> None:
    grid, config = VoxelMapConfig(voxel_size=0.05), InformationConfig(wanted_sigma=0.001)
    bits = surface_bits(0.02, np.linspace(0.5, 5.0, 20), grid, config)
    assert (np.diff(bits) < 0.0).all() and bits[0] > 2.0 > 0.2 > bits[-1] > 0.0


@pytest.mark.parametrize(("sigma", "wanted"), [(0.05, 0.001), (0.05, 0.03), (0.01, 0.03)])
def test_bits_are_the_lost_entropy_of_a_gaussian(sigma: float, wanted: float) -> None:
    grid = VoxelMapConfig(voxel_size=0.1, error_correlation=1.0)
    config = InformationConfig(wanted_sigma=wanted, range_noise=0.01, pixel_angle=0.001)
    after = math.sqrt(1.0 / (1.0 / sigma**2 + 1.0 / (0.01 * 4.0) ** 2))

    def entropy(deviation: float) -> float:
        return 0.5 * math.log2(2.0 * math.pi * math.e * max(deviation, wanted) ** 2)

    bits = surface_bits(sigma, 2.0, grid, config)
    assert bits == pytest.approx(entropy(sigma) - entropy(after), abs=1e-12)


def test_gains_by_voxel_hold_the_surfaces_too(room: VoxelMap) -> None:
    config = InformationConfig(ray_spacing=0.02, wanted_sigma=0.004)
    pose = facing(0.3, (2.0, 1.5, 1.0))
    bits = expected_information(room, pose, CAMERA, 4.0, config=config)[0]
    assert view_gains(room, pose, CAMERA, 4.0, config).total == pytest.approx(bits, rel=1e-5)


@pytest.mark.parametrize("certain", [0.05, 0.02, 0.2])
def test_codes_are_told_apart(certain: float) -> None:
    book = CodeBook(certain, 0.01)
    p, known, sigmas = book.probabilities(), book.known(), book.sigmas()
    assert len(p) == len(known) == len(sigmas) <= 256
    assert (sigmas[: book.surface] == 0.0).all() and (sigmas[book.surface :] > 0.01).all()
    assert (p[book.surface :] > 0.5).all() and known[book.surface :].all()
    assert not known[book.predicted : book.surface].any()
    pairs = set(zip(p[book.surface :].tolist(), sigmas[book.surface :].tolist(), strict=True))
    assert len(pairs) == len(p) - book.surface


def test_too_many_codes_are_refused() -> None:
    with pytest.raises(ConfigError, match="certain_probability"):
        CodeBook(1e-6, 0.01)


@pytest.mark.parametrize(
    ("middle_x", "coarse", "share"), [(3.0, 10.0, 1.0), (90.0, 10.0, 0.0), (90.0, 0.002, 1.0)]
)
def test_precision_is_asked_for_in_fine_places_alone(
    room: VoxelMap, middle_x: float, coarse: float, share: float
) -> None:
    """All of it, nothing, and all of it as what is too coarse is so everywhere."""
    everywhere = InformationConfig(ray_spacing=0.06, wanted_sigma=0.002)
    place = PlacedSolid(Box((8.0, 8.0, 8.0)), make_transform(np.eye(3), (middle_x, 2.0, 1.0)), "")
    there = dataclasses.replace(everywhere, fine_places=(place,), coarse_sigma=coarse)
    pose = facing(0.4, (3.0, 2.0, 1.2))

    assert gained(room, pose, there) == pytest.approx(share * gained(room, pose, everywhere))


def test_a_fine_place_tells_what_its_own_surface_does(room: VoxelMap) -> None:
    """The halves of the room add up to the whole."""
    whole = InformationConfig(ray_spacing=0.06, wanted_sigma=0.002)
    pose = facing(math.pi / 2.0, (3.0, 2.0, 1.2))  # at the wall y = 4, of which x = 3 is the middle
    halves = [
        dataclasses.replace(
            whole,
            fine_places=(PlacedSolid(Box((20.0,) * 3), make_transform(np.eye(3), (x, 0, 0)), ""),),
            coarse_sigma=10.0,
        )
        for x in (-7.0, 13.0)
    ]
    left, right = (gained(room, pose, each) for each in halves)

    assert left > 0.0 and right > 0.0
    assert left + right == pytest.approx(gained(room, pose, whole), rel=1e-6)
