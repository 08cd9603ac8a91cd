"""The models that the software knows: their manifest, and how they are fetched, converted and checked."""
