"""Durable state: rows in a database and files in folders."""
