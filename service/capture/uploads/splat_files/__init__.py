"""Splat files of other tools: 3DGS PLY, SuperSplat's compressed PLY and Niantic's SPZ, row by row."""
