"""The manifest of models that the software knows, and their files."""
