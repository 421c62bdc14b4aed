"""Where the camera is, and how well that is known."""

from infomap_ros.localization.appearance import (
    AppearanceConfig,
    AppearanceMatches,
    describe,
    find_again,
)
from infomap_ros.localization.dead_reckoning import DeadReckoning, DeadReckoningConfig
from infomap_ros.localization.fiducial_selection import FiducialSelectionConfig, select_fiducials
from infomap_ros.localization.fiducial_tracker import FiducialTracker, FiducialTrackerConfig
from infomap_ros.localization.observations import FiducialObservations
from infomap_ros.localization.range_view import DepthView, RangeView, StereoView
from infomap_ros.localization.sparse_stereo import SparseStereoConfig

__all__ = [
    "AppearanceConfig",
    "AppearanceMatches",
    "DeadReckoning",
    "DeadReckoningConfig",
    "DepthView",
    "FiducialObservations",
    "FiducialSelectionConfig",
    "FiducialTracker",
    "FiducialTrackerConfig",
    "RangeView",
    "SparseStereoConfig",
    "StereoView",
    "describe",
    "find_again",
    "select_fiducials",
]
