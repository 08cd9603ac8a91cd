"""The paper's own data sets: its figures beside those of this product."""
