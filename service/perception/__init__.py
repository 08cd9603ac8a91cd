"""Perception: photos to a dictionary of the capture and a label map per view."""
