"""What a strategy and a term of the rating may ask about the views to choose from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Protocol

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.information.view_information import VoxelGains
from infomap_ros.views.information.view_query import InformationConfig
from infomap_ros.views.sampling.coarse_views import (
    CoarseViews,
    InformationWeights,
    coarse_view_at,
    information_weights_of,
)
from infomap_ros.views.sampling.surroundings import IntArray, Surroundings
from infomap_ros.views.situation import Situation, Teammate

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
        """Path of the camera through free space, shape (M,) [m]; inf where none is known."""
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


def claimed_gains(source: InformationSource, situation: Situation) -> VoxelGains | None:
    """What all teammates together are about to be told; None where none has a goal.

    The view that a teammate is heading for is expected to tell something of each voxel that it
    sees, by the same sensor model as one's own views. Of what a view tells of a voxel, that much is
    the teammate's.
    """
    parts = [
        source.gains(_as_seen_by(mate, situation), mate.goal[None])[0]
        for mate in situation.teammates
        if mate.goal is not None
    ]
    return reduce(VoxelGains.joined, parts) if parts else None


def shares_left(
    source: InformationSource, situation: Situation, poses: FloatArray, claimed: VoxelGains | None
) -> FloatArray:
    """Share of the information of views that teammates leave to them.

    Args:
        source: of what views tell.
        situation: with the teammates.
        poses: ``T_map_camera`` of the views, shape (M, 4, 4).
        claimed: what the teammates are about to be told.

    Returns:
        Shape (M,), within [0, 1]; 1 for a view that tells nothing.
    """
    left = np.ones(len(poses))
    if claimed is None:
        return left
    near = np.flatnonzero(_may_overlap(situation.teammates, situation.max_range, poses))
    for index, gains in zip(near, source.gains(situation, poses[near]), strict=True):
        if gains.total > 0.0:
            left[index] = gains.beyond(claimed) / gains.total
    return np.clip(left, 0.0, 1.0)


def _as_seen_by(mate: Teammate, situation: Situation) -> Situation:
    """The situation with the camera and the range of a teammate."""
    return replace(
        situation, camera=mate.camera or situation.camera, max_range=float(mate.max_range)
    )


def _may_overlap(mates: Sequence[Teammate], max_range: float, poses: FloatArray) -> np.ndarray:
    """Which views are near enough to a teammate's next one to see the same."""
    near = np.zeros(len(poses), np.bool_)
    for mate in mates:
        if mate.goal is not None:
            away = np.linalg.norm(poses[:, :3, 3] - mate.goal[:3, 3], axis=1)
            near |= away < max_range + mate.max_range
    return near
