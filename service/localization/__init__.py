"""Visual localization: features, matching, pose solving, refinement, uncertainty, and change detection."""
