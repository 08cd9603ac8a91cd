"""How fast the rasterizer is, against what this machine could do."""
