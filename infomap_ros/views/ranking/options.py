"""What a strategy and a term of the rating may ask about the views to choose from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.information.claimed import claimed_gains, shares_left
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.information_weights import (
    InformationWeights,
    information_weights_of,
)
from infomap_ros.views.information.voxel_gains import VoxelGains
from infomap_ros.views.sampling.coarse_views import CoarseViews, coarse_view_at
from infomap_ros.views.sampling.surroundings import IntArray, Surroundings
from infomap_ros.views.situation import Situation

_RECENT = 24  # views of the past that count


class InformationSource(Protocol):
    """Tells how much views are expected to inform.

    Attributes:
        unit: in which it counts, for texts.
        config: noise law of the sensor.
    """

    @property
    def unit(self) -> str: ...  # noqa: D102
    @property
    def config(self) -> InformationConfig: ...  # noqa: D102

    def quick(
        self, situation: Situation, positions: FloatArray, rotations: FloatArray
    ) -> FloatArray:
        """Of all orientations (P, O, 3, 3) at positions (P, 3), for ranking: (P, O)."""

    def exact(self, situation: Situation, poses: FloatArray) -> FloatArray:
        """Of views ``T_map_camera``, shape (M, 4, 4): (M,)."""

    def gains(self, situation: Situation, poses: FloatArray) -> list[VoxelGains]:
        """Voxels that each view, shape (M, 4, 4), informs, and by how much: what views share."""

    def full_view(self, situation: Situation) -> float:
        """Of a view into nothing but unknown space; the unit in which the rating counts."""


@dataclass(frozen=True, eq=False)
class Options:
    """The views to choose from. What is computed is kept.

    Attributes:
        situation: what is known.
        surroundings: its known space.
        poses: ``T_map_camera`` of the views, shape (M, 4, 4).
        information: expected of each view, in the unit of the source, shape (M,).
        full_view: information of a view into nothing but unknown space.
        source: tells information of other views, and which voxels a view informs.
        rng: for strategies that draw.
        previous: which view is the previous goal, None where there is none.
        fine: whether `information` is exact, and the choice final: the views are then the few
            that a first ranking of all has left.
    """

    situation: Situation
    surroundings: Surroundings
    poses: FloatArray
    information: FloatArray
    full_view: float
    source: InformationSource
    rng: np.random.Generator
    previous: int | None = None
    fine: bool = False

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def positions(self) -> FloatArray:
        """Camera positions, shape (M, 3) [m, map]."""
        return np.asarray(self.poses[:, :3, 3])

    @cached_property
    def path_lengths(self) -> FloatArray:
        """Way of the camera through free space, shape (M,) [m]; inf where none is known."""
        return self.surroundings.path_lengths(self.positions)

    @cached_property
    def information_weights(self) -> InformationWeights:
        """What of the information is wanted, by voxel."""
        return information_weights_of(self.situation, self.surroundings)

    @cached_property
    def coarse_views(self) -> CoarseViews:
        """What a few rays of each view meet."""
        return coarse_view_at(
            self.situation, self.surroundings, self.information_weights, self.poses
        )

    @cached_property
    def claimed(self) -> VoxelGains | None:
        """What teammates are about to be told, voxel by voxel; None where none has a goal."""
        return claimed_gains(self.source, self.situation)

    @cached_property
    def left(self) -> FloatArray:
        """Share of each view's information that teammates leave, shape (M,).

        For the final choice voxel by voxel, for the ranking before it by coarse views.
        """
        if not self.fine:
            return self.coarse_views.left
        return shares_left(self.source, self.situation, self.poses, self.claimed)

    @property
    def recent_views(self) -> FloatArray:
        """The last views that were taken, shape (V, 4, 4)."""
        return self.situation.past_views[-_RECENT:]

    @cached_property
    def left_over(self) -> FloatArray:
        """What each of them is still expected to tell, shape (V,)."""
        return self.source.exact(self.situation, self.recent_views)

    def refined(self, chosen: IntArray, information: FloatArray) -> Options:
        """The few views `chosen`, (N,), with their exact information, (N,)."""
        previous = None
        if self.previous is not None and self.previous in chosen:
            previous = int(np.flatnonzero(chosen == self.previous)[0])
        options = replace(
            self, poses=self.poses[chosen], information=information, previous=previous, fine=True
        )
        options.__dict__["information_weights"] = self.information_weights
        options.__dict__["claimed"] = self.claimed
        options.__dict__["left_over"] = self.left_over
        return options
