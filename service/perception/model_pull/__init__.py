"""Model pulls: fetch, conversion and checks, before models are put in place."""
