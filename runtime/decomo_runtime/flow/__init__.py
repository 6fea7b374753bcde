"""Dense correspondence in files that tools read: `registry.py` has a line for each format, whose module writes it."""
