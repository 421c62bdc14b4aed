"""Where the camera is, and how well that is known."""

from infomap_ros.localization.dead_reckoning import DeadReckoning, DeadReckoningConfig
from infomap_ros.localization.fiducials.appearance import (
    AppearanceConfig,
    AppearanceMatches,
    describe,
    find_again,
)
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.fiducials.range_view import DepthView, RangeView, StereoView
from infomap_ros.localization.fiducials.selection import FiducialSelectionConfig, select_fiducials
from infomap_ros.localization.fiducials.sparse_stereo import SparseStereoConfig
from infomap_ros.localization.fiducials.tracker import FiducialTracker, FiducialTrackerConfig
from infomap_ros.localization.filter.camera_motion import (
    MotionConfig,
    MotionEstimate,
    estimate_motion,
    printed_motion,
)
from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.free_motion import FreeMotionConfig, free_motion
from infomap_ros.localization.filter.motion_prior import KinematicMotion, MotionPrior, RobotPosture
from infomap_ros.localization.filter.records import Fiducials, FilterUpdate, KeptPoses
from infomap_ros.localization.filter.recursive_pose import RecursivePose

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
