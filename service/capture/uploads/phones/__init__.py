"""Recordings of phones with a LiDAR, tracked by ARKit: Polycam's raw data, Record3D, 3D Scanner App's frames."""
