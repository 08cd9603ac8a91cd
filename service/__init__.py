"""Photos to semantic 3D scenes to answers: the product's rooms, free of transports and workers."""
