"""Turns uploads into captures: undistorted views with poses."""
