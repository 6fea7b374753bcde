"""Tracks in the files that people's tools read: `registry.py` has a line for each format, whose module writes it."""
