"""How the camera's pose is estimated from fiducials and motion."""
