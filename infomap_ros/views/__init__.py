"""Where to look next: what views are expected to tell, which are possible, which is best."""

from infomap_ros.views.expected_information import METRICS, expected_information
from infomap_ros.views.information_config import InformationConfig

__all__ = ["METRICS", "InformationConfig", "expected_information"]
