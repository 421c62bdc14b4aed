"""Do two robots' maps contradict each other, as they do when one is not where it thinks?

A surface of one map contradicts the other where that one knows its voxel to be free and holds
nothing occupied in the 26 voxels around it. Maps of one world that lie right on each other
contradict in few voxels, at edges and where things moved; a wrong alignment puts most surfaces of
one into free space of the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping import LOG_ODDS_QUANTUM, NOT_OBSERVED, VoxelMap
from infomap_ros.mapping.voxels.keys import pack_all
from infomap_ros.team.contribution import Contribution

FREE_QUANTA, OCCUPIED_QUANTA = -12, 4  # p < 0.05 and p > 0.73
LEAST_COMPARED, MOST_CONTRADICTED = 100, 0.3
_Evidence = tuple[NDArray[np.int64], NDArray[np.integer[Any]]]
"""Known voxels as ascending numbers, and their evidence in quanta."""


@dataclass(frozen=True)
class Agreement:
    """How two maps fit each other.

    Attributes:
        compared: surface voxels of one of them of which the other knows something.
        contradicted: those of them that the other contradicts.
    """

    compared: int
    contradicted: int

    @property
    def is_contradiction(self) -> bool:
        """Whether the maps cannot both be right; needs `LEAST_COMPARED` voxels."""
        enough = self.compared >= LEAST_COMPARED
        return enough and self.contradicted > MOST_CONTRADICTED * self.compared


def compare(first: Contribution, second: Contribution) -> Agreement:
    """Compare what two robots sent where both know something."""
    return _compare(_evidence_in(first, second), _evidence_in(second, first))


def compare_maps(first: VoxelMap, second: VoxelMap) -> Agreement:
    """Compare two maps where both know something."""
    return _compare(_evidence_of(first), _evidence_of(second))


def _compare(first: _Evidence, second: _Evidence) -> Agreement:
    forth, back = _against(*first, *second), _against(*second, *first)
    return Agreement(forth[0] + back[0], forth[1] + back[1])


def _evidence_of(voxel_map: VoxelMap) -> _Evidence:
    indices, log_odds = voxel_map.voxels()
    keys = pack_all(indices.astype(np.int64))
    order = np.argsort(keys)
    return keys[order], (log_odds[order] / LOG_ODDS_QUANTUM).astype(np.int32)


def _evidence_in(part: Contribution, other: Contribution) -> _Evidence:
    """That in the blocks that both hold."""
    slots = part.slots_in(0, other.coordinates(np.arange(other.blocks)))
    states = part.states(0, slots)
    known = states.log_odds != NOT_OBSERVED
    keys = pack_all(states.indices[known].astype(np.int64))
    order = np.argsort(keys)
    return keys[order], states.log_odds[known][order]


def _against(
    keys: NDArray[np.int64],
    odds: NDArray[np.integer[Any]],
    other_keys: NDArray[np.int64],
    other_odds: NDArray[np.integer[Any]],
) -> tuple[int, int]:
    """How many occupied voxels the other knows, and how many of them it contradicts."""
    surfaces = keys[odds >= OCCUPIED_QUANTA]
    if not len(surfaces) or not len(other_keys):
        return 0, 0
    place = np.minimum(np.searchsorted(other_keys, surfaces), len(other_keys) - 1)
    known = other_keys[place] == surfaces
    free = surfaces[known & (other_odds[place] <= FREE_QUANTA)]
    occupied = other_keys[other_odds > 0]
    steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3)
    offsets = steps @ np.array([1 << 42, 1 << 21, 1])
    near = np.isin(free[:, None] + offsets[None], occupied).any(axis=1)
    return int(np.count_nonzero(known)), int(np.count_nonzero(~near))
