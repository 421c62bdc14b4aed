"""``infomap map``: a bag becomes a map."""
