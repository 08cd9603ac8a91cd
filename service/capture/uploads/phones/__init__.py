"""Reads ARKit recordings of LiDAR phones: Polycam's raw data, Record3D, 3D Scanner App."""
