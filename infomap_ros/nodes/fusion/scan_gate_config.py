"""Which frames map_fusion works in: the parameters."""

from __future__ import annotations

from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, parameter


@dataclass(frozen=True)
class ScanGateConfig:
    """Which frames clouds and poses must have.

    Raises:
        ConfigError: a value is out of its range.
    """

    map_frame: str = parameter("map", "Frame of the map; camera_pose must be given in it.")
    camera_frame: str = parameter(
        "",
        "Optical frame of which camera_pose is the pose. Clouds in another frame are dropped. "
        "Empty: that of the first cloud.",
    )

    def __post_init__(self) -> None:
        check_config(self)
