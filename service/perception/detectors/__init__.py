"""Detectors: images to named boxes."""
