"""The service layer, in process and behind both transports: `SceneService`."""
