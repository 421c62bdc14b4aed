"""Where the camera is, and how well that is known."""
