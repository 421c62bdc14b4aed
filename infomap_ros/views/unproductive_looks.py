"""Voxels that views promised to inform and did not.

A stereo camera measures surfaces, and frees the space before them. Where there is no surface within
its range, as in the sky, or none with texture, nothing comes back however often one looks, and the
unknown voxels there would call for another look for ever. What a view is still expected to tell
right after it has been taken is in vain: that is all it needs to know.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.keys import unpack_all
from infomap_ros.mapping.voxels.voxel_states import put_states, unknown_states

_CERTAINLY_FREE = -60  # [quanta]


LOOK_LIMIT = 1.5
"""A voxel that stays unknown is no longer expected to tell anything after so many looks in vain
from next to it. A look from a distance d counts 1 - (d / max_range)^2.
"""


class UnproductiveLooks:
    """How often each voxel was looked at in vain.

    Args:
        limit: so many of them give a voxel up, see `LOOK_LIMIT`.
    """

    def __init__(self, limit: float = LOOK_LIMIT) -> None:
        self._limit = limit
        self._keys: NDArray[np.int64] = np.zeros(0, np.int64)
        self._counts: FloatArray = np.zeros(0)

    def __len__(self) -> int:
        return len(self._keys)

    def note(
        self, keys: NDArray[np.int64], voxel_map: VoxelMap, position: FloatArray, max_range: float
    ) -> None:
        """Count a look.

        Args:
            keys: packed indices of the voxels that the view just taken is still expected to
                inform, each once, shape (K,).
            voxel_map: with that view.
            position: of the camera, shape (3,) [m, map].
            max_range: of the camera [m].
        """
        unknown = keys[~_known(voxel_map, keys)]
        centers = (unpack_all(unknown) + 0.5) * voxel_map.config.voxel_size
        nearness = np.linalg.norm(centers - position, axis=1) / max_range
        weights = np.maximum(1.0 - nearness**2, 0.0)
        still = ~_known(voxel_map, self._keys)
        keys = np.concatenate([self._keys[still], unknown])
        self._keys, place = np.unique(keys, return_inverse=True)
        counts = np.concatenate([self._counts[still], weights])
        self._counts = np.bincount(place, counts, len(self._keys)).astype(np.float64)

    def are_given_up(self, keys: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether voxels are given up, by their packed indices, shape (K,)."""
        return np.isin(keys, self._keys[self._counts >= self._limit])

    def without_them(self, voxel_map: VoxelMap) -> VoxelMap:
        """A copy of the map in which the voxels that are given up count as free.

        For what views are expected to tell, and for nothing else: nobody has seen that they are.
        The map itself where none is given up.
        """
        given_up = self._keys[self._counts >= self._limit]
        given_up = given_up[~_known(voxel_map, given_up)]
        if not len(given_up):
            return voxel_map
        copy = VoxelMap.from_state(voxel_map.config, voxel_map.state())
        states = unknown_states(unpack_all(given_up).astype(np.int32))
        states.known[:] = True
        states.quanta[:] = _CERTAINLY_FREE
        put_states(copy._storage, states)
        return copy


def _known(voxel_map: VoxelMap, keys: NDArray[np.int64]) -> NDArray[np.bool_]:
    return voxel_map.is_known((unpack_all(keys) + 0.5) * voxel_map.config.voxel_size)


class GainPrior:
    """What share of what views could tell they have told, in their order.

    A camera that looks into the sky, or at a wall closer than it can match, is told nothing, and
    the map goes on promising as much. What the map has gained by a view, against what the view
    still promises, says how far views of its kind are to be trusted; see
    `views.ranking.terms.Repetition`.

    Attributes:
        shares: of each view, 0 to 1; NaN where it is not known.
    """

    def __init__(self) -> None:
        self.shares: list[float] = []
        self._entropy = math.nan

    def note(self, left: Sequence[float], entropy: float) -> None:
        """Count views since the last call; of several it is not known which has told what.

        Args:
            left: what each of them is still expected to tell, oldest first [bits]; NaN for one
                that was wanted, and the robot looked from beside it.
            entropy: of the region of the task with them [bits].
        """
        told = max(self._entropy - entropy, 0.0)
        self._entropy = entropy
        taken = [each for each in left if not math.isnan(each)]
        known = len(taken) == 1 and told + taken[0] > 0.0
        self.shares += [told / (told + each) if known else math.nan for each in left]
