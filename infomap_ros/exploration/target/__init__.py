"""The search for the target whose frame is the map."""
