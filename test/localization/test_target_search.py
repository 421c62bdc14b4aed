"""Looks for a target that is not in sight: together they cover all, and none is in vain."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target import search as search_module
from infomap_ros.localization.target.search import TargetSearch, TargetSearchConfig

CAMERA = PinholeCamera(640, 480, 400.0, 400.0, 319.5, 239.5)
AHEAD = make_transform(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [1.0, 2.0, 3.0]
)  # looks along x, level


def sees(rotation: FloatArray, direction: FloatArray, margin: float) -> bool:
    """Whether a direction is in the image, border left out; written out anew."""
    x, y, z = rotation.T @ direction
    if z <= 0.0:
        return False
    u, v = 400.0 * x / z + 319.5, 400.0 * y / z + 239.5
    across, down = margin * 640, margin * 480
    return across <= u <= 639.0 - across and down <= v <= 479.0 - down


def test_the_proposed_looks_find_a_target_wherever_it_is(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search_module, "_LEAST_GAIN", 0.0)
    search = TargetSearch(CAMERA, TargetSearchConfig(lowest=-0.6, highest=0.3))
    looks = [look.rotation for look in search.proposals(AHEAD, count=100)]
    missed = 0
    for _ in range(500):
        azimuth, elevation = rng.uniform(-np.pi, np.pi), rng.uniform(-0.6, 0.3)
        flat = np.cos(elevation)
        target = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
        missed += not any(sees(look, target, 0.05) for look in looks)
    assert missed <= 2  # between the 800 directions
    assert len(looks) <= 16  # a ring of the field of view's width would be 8 twice


def test_each_look_is_level_and_brings_what_it_says() -> None:
    search = TargetSearch(CAMERA)
    for look in search.proposals(AHEAD):
        assert look.rotation[2, 0] == pytest.approx(0.0, abs=1e-12)  # x axis level
        assert look.rotation[2, 1] <= 0.0  # y axis down
        np.testing.assert_allclose(np.linalg.det(look.rotation), 1.0)
        before = search.seen_share
        search.look(make_transform(look.rotation, np.zeros(3)))
        assert search.seen_share - before == pytest.approx(look.new_share)


def test_nothing_is_proposed_when_all_was_seen() -> None:
    search = TargetSearch(CAMERA)
    for look in search.proposals(AHEAD, count=100):
        search.look(make_transform(look.rotation, np.zeros(3)))
    assert search.proposals(AHEAD, count=100) == []
    assert search.seen_share > 0.95
    search.clear()
    assert search.seen_share == 0.0


def test_what_was_looked_at_is_not_proposed_first() -> None:
    search = TargetSearch(CAMERA)
    first = search.proposals(AHEAD)[0]
    search.look(make_transform(first.rotation, np.zeros(3)))
    following = search.proposals(make_transform(first.rotation, np.zeros(3)))[0]
    turned = Rotation.from_matrix(first.rotation.T @ following.rotation).magnitude()
    assert turned == pytest.approx(following.turn)
    assert turned > 0.5


def test_nearer_looks_come_first() -> None:
    looks = TargetSearch(CAMERA).proposals(AHEAD)
    assert sum(look.turn for look in looks) < 0.75 * len(looks) * np.pi / 2
    assert looks[0].turn < 1.0


def test_only_possible_looks_are_proposed() -> None:
    asked = []

    def faces_forward(rotation: FloatArray) -> bool:
        asked.append(rotation)
        return bool(rotation[0, 2] > 0.0)

    looks = TargetSearch(CAMERA).proposals(AHEAD, is_possible=faces_forward)
    assert looks
    assert all(look.rotation[0, 2] > 0.0 for look in looks)
    assert len(asked) > len(looks)


def test_bad_input_is_named() -> None:
    with pytest.raises(ConfigError, match="lowest"):
        TargetSearchConfig(lowest=0.5, highest=0.1)
    with pytest.raises(InvalidInputError):
        TargetSearch(CAMERA).look(np.ones((4, 4)))
