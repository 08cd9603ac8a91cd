"""Splats of other tools as scenes: pictures around those without photos, labels lifted onto Gaussians that stay."""
