"""The trained scene: its arrays, its files, its exchange formats."""
