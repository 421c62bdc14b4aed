"""A team of robots in one simulated world, and in one simulated network."""
