"""Trains and renders scenes: rasterizer, losses, label blending."""
