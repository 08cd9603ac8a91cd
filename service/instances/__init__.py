"""Proposals of all views and a splat to things: lifting, grouping, hierarchy, surfaces, names."""
