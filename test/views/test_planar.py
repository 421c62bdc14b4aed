"""Views in a plane: sectors instead of pyramids, level directions, nothing beyond the layer."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.state import put_states, unknown_states
from infomap_ros.studies.flight import FreeFlight
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.information.view_query import InformationConfig, camera_rays
from infomap_ros.views.next_best_view import NextBestView, NextBestViewConfig
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import RatingConfig, Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.sampling.candidates import CandidateConfig, find_candidates
from infomap_ros.views.sampling.coarse_views import full_volume
from infomap_ros.views.sampling.orientations import OrientationConfig
from infomap_ros.views.sampling.surroundings import SurroundingsConfig, survey
from infomap_ros.views.situation import RegionOfTask, Situation

from .rooms import facing

SIZE, REACH, SIDE = 0.5, 5.0, 40
CAMERA = PinholeCamera(128, 1, 64.0, 1000.0, 63.5, 0.0)  # 90 degrees, in the plane
SHARP = InformationConfig(min_range=0.0, range_noise=0.0, pixel_angle=1e-4)
LEVEL = NextBestViewConfig(
    rating=RatingConfig(localization_weight=0.0),  # as in the studies, where poses are known
    surroundings=SurroundingsConfig(surface_margin=0, camera_radius=0.0, horizon=100.0, cell=SIZE),
    orientations=OrientationConfig(lowest_elevation=0.0, highest_elevation=0.0),
)


def situation(free: np.ndarray, occupied: np.ndarray, place: tuple[float, float]) -> Situation:
    """A planar task; cells of neither grid, shape (SIDE, SIDE), are unknown."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE, probability_miss=0.04))
    for cells, quanta in ((free, -20), (occupied, 20)):
        places = np.argwhere(cells)
        states = unknown_states(np.column_stack([places, np.zeros(len(places))]).astype(np.int32))
        states.known[:], states.quanta[:] = True, quanta
        put_states(voxel_map._storage, states)
    region = RegionOfTask(np.zeros(3), np.array([SIDE * SIZE, SIDE * SIZE, SIZE]))
    pose = facing(0.0, (*place, 0.5 * SIZE))
    heights = (0.25 * SIZE, 0.75 * SIZE)
    return Situation(voxel_map, CAMERA, REACH, pose, region=region, heights=heights)


def half_known() -> Situation:
    """Free up to x = 10 m, unknown beyond."""
    free = np.zeros((SIDE, SIDE), np.bool_)
    free[:20] = True
    return situation(free, np.zeros_like(free), (8.25, 10.25))


def test_rays_of_a_plane_fill_the_field_of_view() -> None:
    rays, angles = camera_rays(CAMERA, 0.02, planar=True)
    assert angles.sum() == pytest.approx(CAMERA.field_of_view[0])
    np.testing.assert_array_equal(rays[:, 1], 0.0)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
    azimuths = np.arctan2(rays[:, 0], rays[:, 2])
    np.testing.assert_allclose(np.diff(azimuths), 0.5 * (angles[1:] + angles[:-1]))


def test_full_view_is_the_area_of_the_sector() -> None:
    now, source = half_known(), ExpectedInformation(config=SHARP, threads=1)
    bits_per_voxel = 0.25 * np.pi * REACH**2 / SIZE**2
    full = source.full_view(now)
    nothing = situation(*[np.zeros((SIDE, SIDE), np.bool_)] * 2, (10.25, 10.25))
    assert full_volume(now) == pytest.approx(0.25 * np.pi * REACH**2 * SIZE, rel=1e-6)
    one = source.exact(nothing, nothing.T_map_camera[None])[0]
    assert one == pytest.approx(full, rel=1e-3)
    assert 0.3 < full / bits_per_voxel < 1.0  # what one look takes of a bit


def test_information_is_that_of_the_unknown_area_in_sight() -> None:
    """Against counting points of a fine polar grid."""
    now, source = half_known(), ExpectedInformation(config=SHARP, threads=1)
    full = source.full_view(now)
    for azimuth in (0.0, 0.6, 1.4, 3.0):
        pose = facing(azimuth, (8.25, 10.25, 0.5 * SIZE))
        r = (np.arange(600) + 0.5) / 600 * REACH
        angle = azimuth + ((np.arange(600) + 0.5) / 600 - 0.5) * np.pi / 2.0
        beyond = 8.25 + r * np.cos(angle[:, None]) > 10.0
        share = float((beyond * r).sum() / (600 * r.sum()))
        exact = source.exact(now, pose[None])[0] / full
        quick = source.quick(now, pose[None, :3, 3], pose[None, None, :3, :3])[0, 0] / full
        (gains,) = source.gains(now, pose[None])
        assert exact == pytest.approx(share, abs=0.01)
        assert quick == pytest.approx(share, abs=0.04)
        assert gains.total / full == pytest.approx(share, abs=0.02)


def test_only_the_layers_own_unknown_is_periphery() -> None:
    found = survey(half_known(), LEVEL.surroundings)
    assert found.is_whole
    np.testing.assert_allclose(found.targets.places[:, 0], 9.75)
    assert found.targets.counts.sum() == SIDE


def test_no_view_leaves_the_plane() -> None:
    now = half_known()
    choice = NextBestView(LEVEL, "largest_information", ExpectedInformation(config=SHARP))
    flight = FreeFlight(now.voxel_map, now.T_map_camera, now.heights)
    decision = choice.select(now, flight, np.random.default_rng(1))
    assert decision.chosen is not None
    poses = np.array([view.pose for view in decision.candidates])
    np.testing.assert_allclose(poses[:, 2, 3], 0.5 * SIZE)
    np.testing.assert_allclose(poses[:, 2, 2], 0.0, atol=1e-12)
    assert decision.chosen.pose[0, 2] > 0.5  # it looks into the unknown


class Proposing:
    """Wants one view, which no candidate is."""

    requires_positive_utility = False
    view = facing(0.123, (9.25, 3.25, 0.5 * SIZE))

    def propose(self, situation: Situation, surroundings, rng: np.random.Generator) -> np.ndarray:
        return np.array([self.view, facing(0.0, (15.0, 3.0, 0.5 * SIZE))])

    def score(self, options: Options, ratings: Ratings) -> Scores:
        return Scores(np.all(options.poses == self.view, axis=(1, 2)).astype(float))


def test_views_that_a_strategy_proposes_are_candidates() -> None:
    now = half_known()
    choice = NextBestView(LEVEL, Proposing(), ExpectedInformation(config=SHARP))
    flight = FreeFlight(now.voxel_map, now.T_map_camera, now.heights)
    decision = choice.select(now, flight, np.random.default_rng(1))
    assert decision.chosen is not None
    np.testing.assert_array_equal(decision.chosen.pose, Proposing.view)
    ruled_out = [view for view in decision.candidates if view.pose[0, 3] == 15.0]
    assert [view.rejection for view in ruled_out] == ["not known to be free"]


def test_positions_are_drawn_near_the_periphery() -> None:
    """All of them on request, and everywhere without it."""
    now = half_known()
    known = survey(now, LEVEL.surroundings)
    distances = []
    for share in (0.0, 1.0):
        config = CandidateConfig(
            candidates=200, local_share=0.0, periphery_share=share, periphery_distance=1.0
        )
        found = find_candidates(now, known, np.random.default_rng(2), config, LEVEL.orientations)
        distances.append(10.0 - found.positions[1:, 0])  # the first is where the camera is
    assert distances[1].max() <= REACH + 0.5 * SIZE
    assert np.median(distances[1]) < 0.7 * np.median(distances[0])
