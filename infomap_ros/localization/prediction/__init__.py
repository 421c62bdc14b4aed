"""How well the camera's pose will be known at the end of a way not yet gone."""
