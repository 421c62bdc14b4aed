"""Parts of the node stereo_range."""
