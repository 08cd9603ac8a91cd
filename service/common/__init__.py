"""What every room shares: errors, settings, cameras, the dictionary of labels, progress."""
