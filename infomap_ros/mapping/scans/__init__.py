"""How a scan becomes evidence for voxels, and enters the map."""
