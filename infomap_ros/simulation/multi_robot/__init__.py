"""Several robots in one world and one time."""
