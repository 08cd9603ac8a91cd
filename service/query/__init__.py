"""Plain words and poses to ranked objects, 2D masks and 3D masks."""
