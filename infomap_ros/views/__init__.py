"""Where to look next: what views are expected to tell, which are possible, which is best."""

from infomap_ros.views.decision import RatedView, ViewDecision
from infomap_ros.views.goal_memory import GoalMemory
from infomap_ros.views.information.expected_information import METRICS, expected_information
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.information.voxel_gains import VoxelGains, view_gains
from infomap_ros.views.next_best_view import NextBestView, NextBestViewConfig
from infomap_ros.views.reach import FlyingCamera, Reachability, ReachResult
from infomap_ros.views.situation import Interest, RegionOfTask, Situation, Teammate

__all__ = [
    "METRICS",
    "ExpectedInformation",
    "FlyingCamera",
    "GoalMemory",
    "InformationConfig",
    "Interest",
    "NextBestView",
    "NextBestViewConfig",
    "RatedView",
    "ReachResult",
    "Reachability",
    "RegionOfTask",
    "Situation",
    "Teammate",
    "ViewDecision",
    "VoxelGains",
    "expected_information",
    "view_gains",
]
