"""Other raster scans; the paper prints neither the step nor the headings of its own."""

from __future__ import annotations

import math

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategies import Raster
from infomap_ros.views.ranking.strategy import Scores

_VOXEL_STEP = 0.0125  # of the camera's range: a voxel of 5 cm for a range of 4 m
_SHORT_STEP = 0.1  # likewise: about the length of the rover


class VoxelRaster(Raster):
    """Every voxel is a place, by the letter of the paper.

    It takes "the next free location in the known environment from which measurements have not yet
    been made", and the center of each voxel that is known to be free is a location.
    """

    def __init__(self) -> None:
        super().__init__(_VOXEL_STEP)


class SweepRaster(Raster):
    """Goes on from where the camera is, by short steps along rows, and keeps its heading."""

    def __init__(self) -> None:
        super().__init__(_SHORT_STEP)

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Minus the places ahead in the sequence; the smallest turn among views of one place."""
        situation = options.situation
        places = self._places(options, options.poses)
        here = self._places(options, situation.T_map_camera[None])[0]
        taken = np.isin(places, self._places(options, situation.past_views))
        whole = places.max(initial=here) + 1.0
        ahead = np.mod(places - here, whole) + whole * taken
        axes = options.poses[:, :3, 2] @ situation.T_map_camera[:3, 2]
        turns = np.arccos(np.clip(axes, -1.0, 1.0)) / math.pi
        return Scores(-(ahead + 0.5 * turns))

    def _places(self, options: Options, poses: FloatArray) -> FloatArray:
        """Place of poses in the sequence, whatever their heading: (M, 4, 4) -> (M,)."""
        opening = options.situation.camera.field_of_view[0]
        sectors = max(1, math.ceil(2.0 * math.pi / opening))
        return np.floor(self._order(options, poses) / sectors)


class OneWayRaster(SweepRaster):
    """As the sweep, but looks the way of the first view until no such place is left.

    So the camera sees the same part of the scene from places side by side, as the region that the
    paper's scan has mapped in 41 steps suggests.
    """

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Those of the sweep; views that look another way come after all others."""
        values = super().score(options, ratings).values
        situation = options.situation
        first = situation.past_views[0] if len(situation.past_views) else situation.T_map_camera
        along = options.poses[:, :3, 2] @ first[:3, 2]
        narrowest = math.cos(0.5 * situation.camera.field_of_view[0])
        return Scores(values - (along < narrowest) * (1.0 - values.min(initial=0.0)))
