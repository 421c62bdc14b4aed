"""``infomap localize``: a bag becomes a trajectory."""
