"""Files of annotations: each format is a module with `read` and `write` (`registry.py`)."""
