"""The demonstration: a newcomer's first five minutes with the product, through its wire protocols alone."""
