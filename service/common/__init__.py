"""What every package shares: errors, cameras, the dictionary of labels, progress, cancellation."""
