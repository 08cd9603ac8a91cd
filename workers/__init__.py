"""Durable jobs: one worker process that takes them, one trainer process for each."""
