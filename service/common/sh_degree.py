"""Limit of spherical harmonics."""

MAX_SH_DEGREE = 3
"""Highest degree supported by the kernels and file formats."""
