"""Presets, time budgets, the cost of a run, and the speed of this machine."""
