"""Readers of splat files: 3DGS PLY, compressed PLY, SPZ, SOG, .splat and .ksplat."""
