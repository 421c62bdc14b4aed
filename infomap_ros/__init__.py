"""Information-driven stereo mapping for mobile manipulators with ROS 2."""

from pathlib import Path as _Path

from infomap_ros._kernel_cache import use_kernel_cache as _use_kernel_cache

_use_kernel_cache(_Path(__file__).resolve().parent)
