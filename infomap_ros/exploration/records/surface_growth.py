"""Which surface voxels each decision was the first to know, as a short text of the run log."""

from __future__ import annotations

import base64
import zlib

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import RunLogError
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.keys import pack_all, unpack_all

LARGEST = 250_000
"""Of larger surfaces nothing is told: a log must stay small, and a choice quick."""
_KEY_BYTES = 8


class SurfaceGrowth:
    """Tells of each surface voxel once."""

    def __init__(self) -> None:
        self._told = np.empty(0, np.int64)

    def text(self, voxel_map: VoxelMap) -> str:
        """The surface voxels that no text before has told; empty where there are none.

        Args:
            voxel_map: as it is now.
        """
        if voxel_map.surface_voxels > LARGEST:
            return ""
        new = np.setdiff1d(pack_all(voxel_map.gaussians()[0].astype(np.int64)), self._told)
        self._told = np.union1d(self._told, new)
        steps = np.diff(new, prepend=0).astype("<i8")  # small numbers, which zlib makes short
        return base64.b64encode(zlib.compress(steps.tobytes())).decode("ascii") if len(new) else ""


def grown_voxels(text: str) -> NDArray[np.int64]:
    """Voxel indices of what `SurfaceGrowth` has told, shape (K, 3).

    Raises:
        RunLogError: it is no such text.
    """
    try:
        unpacker, packed = zlib.decompressobj(), base64.b64decode(text, validate=True)
        unpacked = unpacker.decompress(packed, LARGEST * _KEY_BYTES)
        if packed and not unpacker.eof:
            raise ValueError("it is cut off")
        keys = np.cumsum(np.frombuffer(unpacked, "<i8"))
    except (ValueError, zlib.error) as error:
        raise RunLogError(f"'surface' of a decision cannot be read: {error}") from error
    return unpack_all(keys)
