"""How well the camera's pose will be known at the end of a path not yet gone."""
