"""Durable jobs: a worker process claims them, one trainer process runs each."""
