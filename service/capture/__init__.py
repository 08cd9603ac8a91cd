"""Turns uploads into captures: photos, videos, COLMAP models and transforms.json in; undistorted posed views out."""
