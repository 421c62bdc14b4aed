"""Raster scans with shorter steps; the paper prints neither step nor headings of its own."""

from __future__ import annotations

from infomap_ros.views.strategies import Raster

_SHORT_STEP = 0.1  # of the camera's range
_VOXEL_STEP = 0.0125  # likewise: a voxel of 5 cm for a range of 4 m


class ShortStepRaster(Raster):
    """Places a tenth of the camera's range apart, about the length of the rover."""

    def __init__(self) -> None:
        super().__init__(_SHORT_STEP)


class VoxelRaster(Raster):
    """Every voxel is a place, by the letter of the paper.

    It takes "the next free location in the known environment from which measurements have not yet
    been made", and the centre of each voxel that is known to be free is a location.
    """

    def __init__(self) -> None:
        super().__init__(_VOXEL_STEP)
