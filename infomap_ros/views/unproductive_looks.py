"""Voxels that views promised to inform and did not.

A stereo camera measures surfaces, and frees the space before them. Where there is no surface within
its range, as in the sky, or none with texture, nothing comes back however often one looks, and the
unknown voxels there would call for another look for ever. What a view is still expected to tell
right after it has been taken is in vain: that is all it needs to know.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.keys import COORDINATE_LIMIT
from infomap_ros.mapping.voxels.voxel_states import put_states, unknown_states

_BITS, _MASK = 21, (1 << 21) - 1
_CERTAINLY_FREE = -60  # [quanta]


@dataclass(frozen=True)
class UnproductiveLooksConfig:
    """When a voxel is given up.

    Raises:
        ConfigError: a value is out of its range.
    """

    look_limit: float = setting(
        1.5,
        "A voxel that stays unknown is no longer expected to tell anything after so many looks in "
        "vain from next to it. A look from a distance d counts 1 - (d / max_range)^2.",
        low=0.01,
        high=1e6,
    )

    def __post_init__(self) -> None:
        check_config(self)


class UnproductiveLooks:
    """How often each voxel was looked at in vain.

    Args:
        config: when a voxel is given up.
    """

    def __init__(self, config: UnproductiveLooksConfig | None = None) -> None:
        self.config = config or UnproductiveLooksConfig()
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
        centers = (_indices(unknown) + 0.5) * voxel_map.config.voxel_size
        nearness = np.linalg.norm(centers - position, axis=1) / max_range
        weights = np.maximum(1.0 - nearness**2, 0.0)
        still = ~_known(voxel_map, self._keys)
        keys = np.concatenate([self._keys[still], unknown])
        self._keys, place = np.unique(keys, return_inverse=True)
        counts = np.concatenate([self._counts[still], weights])
        self._counts = np.bincount(place, counts, len(self._keys)).astype(np.float64)

    def are_given_up(self, keys: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether voxels are given up, by their packed indices, shape (K,)."""
        return np.isin(keys, self._keys[self._counts >= self.config.look_limit])

    def without_them(self, voxel_map: VoxelMap) -> VoxelMap:
        """A copy of the map in which the voxels that are given up count as free.

        For what views are expected to tell, and for nothing else: nobody has seen that they are.
        The map itself where none is given up.
        """
        given_up = self._keys[self._counts >= self.config.look_limit]
        given_up = given_up[~_known(voxel_map, given_up)]
        if not len(given_up):
            return voxel_map
        copy = VoxelMap.from_state(voxel_map.config, voxel_map.state())
        states = unknown_states(_indices(given_up).astype(np.int32))
        states.known[:] = True
        states.quanta[:] = _CERTAINLY_FREE
        put_states(copy._storage, states)
        return copy


def _indices(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Voxel indices of packed keys, shape (K, 3)."""
    parts = [keys >> (2 * _BITS), (keys >> _BITS) & _MASK, keys & _MASK]
    return np.stack(parts, axis=1) - COORDINATE_LIMIT


def _known(voxel_map: VoxelMap, keys: NDArray[np.int64]) -> NDArray[np.bool_]:
    return voxel_map.is_known((_indices(keys) + 0.5) * voxel_map.config.voxel_size)
