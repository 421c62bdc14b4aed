"""Where to look next: what views are expected to tell, which are possible, which is best."""

from infomap_ros.views.expected_information import METRICS, expected_information
from infomap_ros.views.information_config import InformationConfig
from infomap_ros.views.shared_rays import information_of_views
from infomap_ros.views.voxel_gains import VoxelGains, view_gains

__all__ = [
    "METRICS",
    "InformationConfig",
    "VoxelGains",
    "expected_information",
    "information_of_views",
    "view_gains",
]
