"""Lexicons: words to their senses, with definitions and what is a kind or a part of what."""
