"""Utilities shared by all packages: cancellation, label dictionary, progress and others."""
