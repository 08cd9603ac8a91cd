"""Text encoders: words to embeddings."""
