"""Gaussian rasterization behind one interface with three backends."""
