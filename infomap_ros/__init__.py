"""Information-driven stereo mapping for mobile manipulators with ROS 2.

``infomap_ros.map_bag("bags/rover_rocks").show()`` maps a bag and opens the map in a browser.
"""

from importlib import import_module as _import_module
from pathlib import Path as _Path
from typing import Any as _Any

from infomap_ros._kernel_cache import use_kernel_cache as _use_kernel_cache

__version__ = "0.1.0"

_use_kernel_cache(_Path(__file__).resolve().parent)

_PLACES = {
    "VoxelMap": "infomap_ros.mapping",
    "localize_bag": "infomap_ros.replay.mapped_bag",
    "map_bag": "infomap_ros.replay.mapped_bag",
}
"""Where the names are that are loaded when they are asked for: they take seconds."""


def __getattr__(name: str) -> _Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(_PLACES[name]), name)
