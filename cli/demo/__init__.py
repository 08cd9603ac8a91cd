"""The sample in the browser, and the main job on a capture, end to end: `fastsplat demo`."""
