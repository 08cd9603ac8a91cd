"""Lexicons: senses of words, with definitions, hypernyms and parts."""
