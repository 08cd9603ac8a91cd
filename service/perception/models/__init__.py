"""The manifest of known models, and their files."""
