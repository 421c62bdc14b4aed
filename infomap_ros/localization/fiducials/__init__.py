"""How fiducials of the scene are seen: chosen, ranged, followed, and found again."""
