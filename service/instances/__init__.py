"""Instance segmentation of a scene: mask proposals of all views become named things."""
