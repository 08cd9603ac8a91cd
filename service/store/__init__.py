"""Durable state: rows in a database, blobs on disk."""
