"""What a view is expected to tell about the map, in bits."""
