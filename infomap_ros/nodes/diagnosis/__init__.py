"""``infomap doctor``: what a live graph lacks."""
