"""Information-driven stereo mapping for mobile manipulators with ROS 2.

``infomap_ros.map_bag("bags/rover_rocks").show()`` maps a bag and opens the map in a browser.
"""

from importlib import import_module as _import_module
from os import environ as _environ
from pathlib import Path as _Path
from typing import Any as _Any

from infomap_ros._kernel_cache import use_kernel_cache as _use_kernel_cache

__version__ = "0.1.0"
# Of any image, before it is decoded: few bytes may unfold to gigabytes. OpenCV reads it once.
_environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 26))

_use_kernel_cache(_Path(__file__).resolve().parent)


def names_on_demand(package: str, places: dict[str, str]) -> _Any:
    """The ``__getattr__`` of a package whose names, each in a module, take seconds to load."""

    def load(name: str) -> _Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(_import_module(f"{package}.{places[name]}"), name)

    return load


_PLACES = {"VoxelMap": "mapping"} | dict.fromkeys(("localize_bag", "map_bag"), "replay.mapped_bag")
__getattr__ = names_on_demand(__name__, _PLACES)
