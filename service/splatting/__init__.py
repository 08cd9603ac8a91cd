"""Training of scenes, and what draws them: rasterizer, losses, label blending."""
