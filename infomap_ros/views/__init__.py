"""Where to look next: what views are expected to tell, which are possible, which is best."""

from infomap_ros import names_on_demand

_INFORMATION = "information.view_information"
__getattr__ = names_on_demand(__name__, {"expected_information": _INFORMATION})
