"""Spherical harmonics of a color."""

MAX_SH_DEGREE = 3
"""Kernels and file formats know no higher one."""
