"""What the product does for its callers, in process and behind both transports: `SceneService`."""
