"""The sparse voxel map: occupancy and one Gaussian per surface voxel."""

from infomap_ros.mapping.config import (
    LOG_ODDS_QUANTUM,
    NOT_OBSERVED,
    SHARED_LOG_ODDS_LIMIT,
    VoxelMapConfig,
)
from infomap_ros.mapping.scans.integration import IntegrationReport
from infomap_ros.mapping.terrain.terrain import Terrain, terrain_of
from infomap_ros.mapping.voxel_map import DepthImage, VoxelMap
from infomap_ros.mapping.voxels.changes import VoxelChanges
from infomap_ros.mapping.voxels.window import (
    FREE,
    OCCUPIED,
    UNCERTAIN,
    UNKNOWN,
    OccupancyThresholds,
    VoxelWindow,
)

__all__ = [
    "FREE",
    "LOG_ODDS_QUANTUM",
    "NOT_OBSERVED",
    "OCCUPIED",
    "SHARED_LOG_ODDS_LIMIT",
    "UNCERTAIN",
    "UNKNOWN",
    "DepthImage",
    "IntegrationReport",
    "OccupancyThresholds",
    "Terrain",
    "VoxelChanges",
    "VoxelMap",
    "VoxelMapConfig",
    "VoxelWindow",
    "terrain_of",
]
