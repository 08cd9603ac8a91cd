"""The pull of models: fetched, converted and checked before they are put in place."""
