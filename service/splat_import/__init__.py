"""Turns splats of other tools into scenes: pictures rendered, labels lifted onto Gaussians."""
