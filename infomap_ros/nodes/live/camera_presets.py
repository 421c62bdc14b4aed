"""The topics of common camera drivers, so that a launch argument takes the place of remaps.

Names are those under which a driver publishes with its own launch file, relative to the robot's
namespace.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from infomap_ros.errors import ConfigError


@dataclass(frozen=True)
class CameraPreset:
    """How a driver's images are used.

    Attributes:
        source: stereo or depth, as parameter of stereo_range and fiducial_localization.
        rectify: whether images are raw.
        topics: those of the nodes, and those of the driver in their place.
    """

    source: str
    rectify: bool
    topics: Mapping[str, str]


def _pair(left: str, right: str, image: str) -> CameraPreset:
    """A pair of rectified images, each below a topic of its own."""
    topics: dict[str, str] = {}
    for side, place in (("left", left), ("right", right)):
        topics |= {f"{side}/image_rect": f"{place}/{image}"}
        topics |= {f"{side}/camera_info": f"{place}/camera_info"}
    return CameraPreset("stereo", False, topics)


_REALSENSE = "camera/camera"

PRESETS: Mapping[str, CameraPreset] = {
    "realsense": _pair(f"{_REALSENSE}/infra1", f"{_REALSENSE}/infra2", "image_rect_raw"),
    "realsense_depth": CameraPreset(
        "depth",
        False,
        {
            "depth/image_rect": f"{_REALSENSE}/aligned_depth_to_color/image_raw",
            "depth/camera_info": f"{_REALSENSE}/aligned_depth_to_color/camera_info",
            "rgb/image_rect": f"{_REALSENSE}/color/image_raw",
        },
    ),
    "zed": _pair("zed/zed_node/left", "zed/zed_node/right", "image_rect_color"),
    "oak": _pair("oak/left", "oak/right", "image_rect"),
}
"""By the value of the launch argument ``camera``."""


def camera_preset(name: str) -> CameraPreset | None:
    """The preset of that name, None for an empty one.

    Raises:
        ConfigError: there is none.
    """
    if name and name not in PRESETS:
        raise ConfigError("camera", name, f"one of {', '.join(PRESETS)}")
    return PRESETS.get(name)
