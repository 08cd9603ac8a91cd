"""Scenes in notebooks and scripts, without a server."""
