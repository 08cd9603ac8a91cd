"""The `fastsplat` command."""
