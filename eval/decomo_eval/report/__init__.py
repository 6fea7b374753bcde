"""A report that can be read, mailed and pasted: one HTML page, and the same numbers as JSON, CSV and a LaTeX row."""
