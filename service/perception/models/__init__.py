"""The models the product knows: what they are (`manifest`), where they come from (`pull`), which file is which part."""
