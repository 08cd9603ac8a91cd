"""Photos to poses in a finished scene: kept features, matches, a pose, its uncertainty, and what the photo shows."""
