"""Parts of the node fiducial_localization."""
