"""Whether the robot touches itself or the map."""
