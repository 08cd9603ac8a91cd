"""Segmenters: boxes to masks."""
