"""The map as files, pictures and 2-D grids."""
