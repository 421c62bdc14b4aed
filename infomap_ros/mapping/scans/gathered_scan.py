"""What gathering a scan leaves: its points by voxel, and the voxels that it sees through."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from infomap_ros.errors import CapacityError
from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.scans.scan import ScanRows
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE
from infomap_ros.mapping.voxels.storage import FreeBlocks

FREE_BLOCK_BYTES = 64.0


@dataclass(frozen=True, eq=False)
class GatheredScan:
    """A scan by voxel; valid until the next one is gathered.

    Attributes:
        parts: the points by voxel, in one or more parts that share no voxel with points.
        free: the blocks that the scan sees through.
        see: ``see(first, last)`` finds which voxels of the blocks [first, last) are free.
        unseen: number of blocks for which that remains to be done.
    """

    parts: list[ScanRows]
    free: FreeBlocks
    see: Callable[[int, int], None]
    unseen: int


def check_block_count(count: int, config: VoxelMapConfig) -> None:
    """Refuse a scan that alone would fill the memory limit.

    Raises:
        CapacityError: it would.
    """
    if count * FREE_BLOCK_BYTES > config.memory_limit * 1e9:
        raise CapacityError(
            f"one scan sees through {count} blocks or more of {BLOCK_SIDE}^3 voxels, too many "
            f"for the memory limit of {config.memory_limit:g} GB: reduce max_range or enlarge "
            "voxel_size"
        )
