"""Candidates against the map's own point queries."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PlacedSolid, Sphere, make_transform
from infomap_ros.views.sampling import candidates as c
from infomap_ros.views.sampling.candidates import CandidateConfig, Candidates, find_candidates
from infomap_ros.views.sampling.orientations import OrientationConfig, look_rotations
from infomap_ros.views.sampling.surroundings import SurroundingsConfig, survey
from infomap_ros.views.situation import Interest, RegionOfTask, Situation, Teammate

from .rooms import CAMERA, facing, seen_room, turning

ROOM = (6.0, 4.0, 2.5)
WALL = ((3.0, 0.0, 0.0, 3.2, 4.0, 2.5),)
START = (1.5, 2.0, 1.2)
VIEWS = OrientationConfig(directed=3, spread=2)


@pytest.fixture(scope="module")
def divided() -> Situation:
    """A room with a wall through it, seen from both sides; the camera is on the low side."""
    poses = [*turning(START), *turning((4.6, 2.0, 1.2))]
    region = RegionOfTask((0, 0, 0), ROOM)
    return Situation(seen_room(poses, ROOM, WALL), CAMERA, 4.0, poses[0], region=region)


def find(situation: Situation, seed: int = 1, **settings: float) -> Candidates:
    rng = np.random.default_rng(seed)
    config = CandidateConfig(**{"candidates": 200, **settings})
    return find_candidates(situation, survey(situation), rng, config, VIEWS)


def changed(situation: Situation, **fields: object) -> Situation:
    names = ("voxel_map", "camera", "max_range", "T_map_camera", "region")
    return Situation(**{**{name: getattr(situation, name) for name in names}, **fields})


def test_positions_are_free_with_their_whole_ball(divided: Situation) -> None:
    found = find(divided)
    assert len(found.positions) == 40
    steps = np.stack(np.meshgrid(*[(-0.1, 0.0, 0.1)] * 3), axis=-1).reshape(-1, 3)
    steps = steps[np.linalg.norm(steps, axis=1) <= 0.1 + 1e-9]
    moved = found.positions[1:]  # the first is where the camera is
    around = (moved[:, None] + steps).reshape(-1, 3)
    known = divided.voxel_map.is_known(around)
    probability = np.where(known, divided.voxel_map.probability(around), 0.5)
    size, block = divided.voxel_map.config.voxel_size, np.indices((3, 3, 3)).reshape(3, -1).T - 1
    walls = np.minimum(around, np.array((3.0, 4.0, 2.5)) - around).min(axis=1)
    for point in around[(probability >= 0.05) & (known | (walls >= 0.3))]:
        # Scans leave a margin before surfaces; elsewhere only holes in free space.
        near = divided.voxel_map.probability(point + size * block)
        assert near.max() < 0.95 and (near < 0.05).sum() >= 13
    assert (found.positions[:, 0] < 3.0).all()  # none beyond the wall


def test_present_position_is_a_candidate(divided: Situation) -> None:
    np.testing.assert_array_equal(find(divided).positions[0], START)


def test_same_seed_gives_the_same_and_another_others(divided: Situation) -> None:
    first, again, other = find(divided, 3), find(divided, 3), find(divided, 4)
    np.testing.assert_array_equal(first.poses, again.poses)
    assert not np.array_equal(first.positions, other.positions)


def test_local_candidates_are_near(divided: Situation) -> None:
    found = find(divided, local_share=1.0, local_radius=0.6)
    gaps = np.linalg.norm(found.positions - START, axis=1)
    assert len(gaps) == 40 and gaps.max() <= 0.66
    far = np.linalg.norm(find(divided, local_share=0.0).positions - START, axis=1)
    assert far.max() > 1.2


def test_a_camera_fixed_on_a_base_gets_views_at_its_height_and_elevation(
    divided: Situation,
) -> None:
    ahead = changed(
        divided,
        heights=(1.013, 1.013),
        elevations=(-0.2, -0.2),
        ground_height=lambda places: np.full(len(places), 0.1),
    )
    found = find(ahead)
    assert len(found.positions) == 40
    np.testing.assert_allclose(found.positions[:, 2], 1.113, atol=1e-9)
    np.testing.assert_allclose(np.arcsin(found.orientations[..., 2, 2]), -0.2, atol=1e-9)
    azimuths = np.arctan2(found.orientations[..., 1, 2], found.orientations[..., 0, 2])
    assert np.ptp(azimuths) > 5.0


def test_each_rejected_position_has_its_reason(divided: Situation) -> None:
    reasons = {
        (1.0, 2.0, 1.2): "",
        (2.0, 2.0, 1.9): c.OUTSIDE_HEIGHTS,
        (3.1, 2.0, 1.2): c.NOT_FREE,
        (2.85, 2.0, 1.2): c.NO_ROOM,
        (4.05, 2.05, 1.25): c.NOT_CONNECTED,
        (30.0, 2.0, 1.2): c.OUTSIDE_REGION,
        (1.0, 2.6, 1.2): c.NEAR_TEAMMATE,
    }
    mate = Teammate(np.array((1.0, 3.0, 1.2)))
    asked = changed(divided, heights=(0.2, 1.7), teammates=(mate,))
    views = np.array([facing(0.0, place) for place in reasons])
    found = find_candidates(
        asked, survey(asked), np.random.default_rng(0), CandidateConfig(candidates=6), extra=views
    )
    given = {
        tuple(pose[:3, 3]): why for pose, why in zip(found.rejected, found.reasons, strict=True)
    }
    rejected = {place: why for place, why in reasons.items() if why}
    assert {place: given[place] for place in rejected} == rejected
    np.testing.assert_allclose(found.extra[:, :3, 3], [(1.0, 2.0, 1.2)])


def test_far_from_everything_there_is_nothing_to_see(divided: Situation) -> None:
    found = find(divided, periphery_distance=0.01)
    assert set(found.reasons) >= {c.NOTHING_NEAR}


def test_heights_count_from_the_ground(divided: Situation) -> None:
    def slope(places: np.ndarray) -> np.ndarray:
        return 0.3 * places[:, 0]

    found = find(changed(divided, heights=(0.5, 0.9), ground_height=slope))
    above = found.positions[:, 2] - 0.3 * found.positions[:, 0]
    assert len(above) == 40 and above.min() >= 0.5 and above.max() <= 0.9


def test_unknown_ground_is_left_to_the_arm_near_by(divided: Situation) -> None:
    def unknown(places: np.ndarray) -> np.ndarray:
        return np.full(len(places), np.nan)

    found = find(changed(divided, heights=(0.5, 0.9), ground_height=unknown), local_radius=0.5)
    assert len(found.positions) > 5
    assert np.linalg.norm(found.positions - START, axis=1).max() <= 0.55


def test_extra_views_are_tested_too(divided: Situation) -> None:
    good, bad = facing(1.0, (2.0, 2.0, 1.2)), facing(1.0, (4.05, 2.05, 1.25))
    rng = np.random.default_rng(0)
    found = find_candidates(divided, survey(divided), rng, CandidateConfig(), VIEWS, (good, bad))
    np.testing.assert_array_equal(found.extra, [good])
    np.testing.assert_array_equal(found.poses[-1], good)
    np.testing.assert_array_equal(found.rejected[-1], bad)
    assert found.reasons[-1] == c.NOT_CONNECTED


def test_less_room_gives_fewer_candidates_not_worse_ones(divided: Situation) -> None:
    rng = np.random.default_rng(0)
    tight = survey(divided, SurroundingsConfig(camera_radius=1.1))
    found = find_candidates(divided, tight, rng, CandidateConfig(candidates=5000), VIEWS)
    assert 0 < len(found.positions) < 500


@pytest.mark.parametrize(
    ("azimuth", "elevation", "axis"),
    [(0.0, 0.0, (1, 0, 0)), (np.pi / 2, 0.0, (0, 1, 0)), (0.0, np.pi / 2, (0, 0, 1))],
)
def test_rotations_look_along_the_angles(azimuth: float, elevation: float, axis: ArrayLike) -> None:
    rotation = look_rotations(np.array([azimuth]), np.array([elevation]))[0]
    np.testing.assert_allclose(rotation[:, 2], axis, atol=1e-12)


def test_rotations_are_proper_and_level(rng: np.random.Generator) -> None:
    rotations = look_rotations(rng.uniform(-3, 3, 50), rng.uniform(-1.5, 1.5, 50))
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    np.testing.assert_allclose(rotations[:, 2, 0], 0.0, atol=1e-12)  # x is horizontal
    assert (rotations[:, 2, 1] <= 0.0).all()  # y points down


def test_elevations_keep_their_limits(divided: Situation) -> None:
    rng = np.random.default_rng(0)
    views = OrientationConfig(directed=2, spread=3, lowest_elevation=-0.6, highest_elevation=0.1)
    found = find_candidates(divided, survey(divided), rng, CandidateConfig(), views)
    elevations = np.arcsin(found.poses[:, 2, 2])
    assert elevations.min() >= -0.6 - 1e-9 and elevations.max() <= 0.1 + 1e-9


def test_directed_views_look_at_what_is_unknown() -> None:
    poses = [facing(angle, START) for angle in (-0.5, 0.0, 0.5)]
    region = RegionOfTask((0, 0, 0), ROOM)
    half = Situation(seen_room(poses, ROOM), CAMERA, 4.0, poses[1], region=region)
    rng = np.random.default_rng(0)
    views = OrientationConfig(directed=1, spread=1)
    found = find_candidates(half, survey(half), rng, CandidateConfig(candidates=200), views)
    directed, spread = found.orientations[:, 0, :, 2], found.orientations[:, 1, :, 2]
    # The periphery of what was seen ahead lies behind and beside the cone of the three views.
    middle = found.positions[:, 0] > 2.5
    assert directed[middle, 0].mean() < spread[middle, 0].mean() - 0.3


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="lowest_elevation"):
        OrientationConfig(lowest_elevation=0.5, highest_elevation=0.2)
    with pytest.raises(ConfigError, match="directed"):
        OrientationConfig(directed=0, spread=0)
    with pytest.raises(InvalidInputError, match="region"):
        RegionOfTask((0, 0, 0), (1, 0, 1))
    with pytest.raises(InvalidInputError, match="interest"):
        Interest(PlacedSolid(Sphere(1.0), make_transform(np.eye(3), (0, 0, 0))), -1.0)
    with pytest.raises(InvalidInputError, match="teammate position"):
        Teammate(np.array((0.0, np.nan, 0.0)))


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({"max_range": -1.0}, "max_range"),
        ({"heights": (1.0, 0.5)}, "heights"),
        ({"T_map_camera": np.zeros((4, 4))}, "T_map_camera"),
        ({"pose_covariance": -np.eye(6)}, "pose_covariance"),
    ],
)
def test_impossible_situations_are_refused(
    divided: Situation, fields: dict[str, object], name: str
) -> None:
    with pytest.raises(InvalidInputError, match=name):
        changed(divided, **fields)
