"""What every package shares beside the contract: cancellation, the dictionary of labels, progress."""
