"""Unknown voxels of a field by their predicted probability (Markov prediction)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelMap
from infomap_ros.mapping.prediction import PredictionConfig, predict_unknown
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, local_index
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA
from infomap_ros.views.information.codes import UNKNOWN, CodeBook
from infomap_ros.views.information.field import VisibleField, with_rows

_LEAST_PROBABILITY = 1e-7


def with_predictions(
    field: VisibleField,
    m: VoxelMap,
    book: CodeBook,
    config: PredictionConfig | None = None,
) -> VisibleField:
    """The field with unknown voxels near known ones as `predict_unknown` predicts them.

    No more certain than the least certain EMPTY or SOLID voxel: nobody has looked there.

    Args:
        field: of the map.
        m: the map.
        book: that the field was made with.
        config: of the prediction.
    """
    size = field.voxel_size
    low = (field.first * BLOCK_SIDE + 0.5) * size
    high = low + (np.array(field.directory.shape) * BLOCK_SIDE - 1) * size
    window = m.window(low, high)
    p = np.clip(predict_unknown(window, config), _LEAST_PROBABILITY, 1.0 - _LEAST_PROBABILITY)
    limit = book.limit
    levels = np.rint(np.log(p / (1.0 - p)) / LOG_ODDS_QUANTUM).clip(-limit, limit).astype(np.int16)
    levels[window.quanta != UNKNOWN_QUANTA] = 0
    blank = field.directory == -1 - UNKNOWN
    told = np.logical_or.reduceat(levels != 0, np.arange(0, levels.shape[0], BLOCK_SIDE), axis=0)
    for axis in (1, 2):
        told = np.logical_or.reduceat(told, np.arange(0, levels.shape[axis], BLOCK_SIDE), axis=axis)
    field = with_rows(field, np.argwhere(blank & told))
    _enter(field.directory, window.quanta, levels, book.predicted + limit, field.codes)
    return field


@njit(cache=True, nogil=True)
def _enter(
    directory: NDArray[Any], quanta: Any, levels: Any, even: int, codes: NDArray[Any]
) -> None:
    """Write the codes of the unknown voxels; `even` is the code of level 0."""
    nx, ny, nz = levels.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if quanta[i, j, k] == UNKNOWN_QUANTA and levels[i, j, k] != 0:
                    row = directory[i // BLOCK_SIDE, j // BLOCK_SIDE, k // BLOCK_SIDE]
                    codes[row, local_index(i, j, k)] = even + levels[i, j, k]
