"""Metrics of a trained scene on data sets whose truth is known."""
