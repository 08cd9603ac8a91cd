"""Data sets of papers: their figures beside those of this product."""
