"""The target whose frame is the map: boards of tags, CAD models, tags on robots."""
