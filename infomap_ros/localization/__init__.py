"""Where the camera is, and how well that is known."""

from infomap_ros.localization.dead_reckoning import DeadReckoning, DeadReckoningConfig

__all__ = ["DeadReckoning", "DeadReckoningConfig"]
