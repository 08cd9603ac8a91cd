"""Image and label losses of renderings."""
