"""Where the camera is, and how well that is known."""

from infomap_ros.localization.appearance import (
    AppearanceConfig,
    AppearanceMatches,
    describe,
    find_again,
)
from infomap_ros.localization.camera_motion import (
    MotionConfig,
    MotionEstimate,
    estimate_motion,
    printed_motion,
)
from infomap_ros.localization.dead_reckoning import DeadReckoning, DeadReckoningConfig
from infomap_ros.localization.fiducial_filter import FiducialFilter
from infomap_ros.localization.fiducial_selection import FiducialSelectionConfig, select_fiducials
from infomap_ros.localization.fiducial_tracker import FiducialTracker, FiducialTrackerConfig
from infomap_ros.localization.filter_config import FiducialFilterConfig
from infomap_ros.localization.filter_records import Fiducials, FilterUpdate, KeptPoses
from infomap_ros.localization.motion_prior import (
    FreeMotionConfig,
    KinematicMotion,
    MotionPrior,
    RobotPosture,
    free_motion,
)
from infomap_ros.localization.observations import FiducialObservations
from infomap_ros.localization.range_view import DepthView, RangeView, StereoView
from infomap_ros.localization.recursive_pose import RecursivePose
from infomap_ros.localization.sparse_stereo import SparseStereoConfig

__all__ = [
    "AppearanceConfig",
    "AppearanceMatches",
    "DeadReckoning",
    "DeadReckoningConfig",
    "DepthView",
    "FiducialFilter",
    "FiducialFilterConfig",
    "FiducialObservations",
    "FiducialSelectionConfig",
    "FiducialTracker",
    "FiducialTrackerConfig",
    "Fiducials",
    "FilterUpdate",
    "FreeMotionConfig",
    "KeptPoses",
    "KinematicMotion",
    "MotionConfig",
    "MotionEstimate",
    "MotionPrior",
    "RangeView",
    "RecursivePose",
    "RobotPosture",
    "SparseStereoConfig",
    "StereoView",
    "describe",
    "estimate_motion",
    "find_again",
    "free_motion",
    "printed_motion",
    "select_fiducials",
]
