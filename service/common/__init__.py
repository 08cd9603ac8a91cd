"""What every room shares beside the contract: cancellation, the dictionary of labels, progress."""
