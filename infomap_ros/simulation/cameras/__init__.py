"""What the cameras of a robot take."""
