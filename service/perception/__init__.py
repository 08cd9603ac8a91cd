"""Photos to a dictionary of what is in the capture, and a label map per view."""
