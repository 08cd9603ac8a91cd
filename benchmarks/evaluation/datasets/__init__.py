"""Data sets with a truth: what a scene may be trained on, and what it is measured on."""
