"""A whole benchmark, fitted: every video prepared, fitted, exported and scored, whatever happens to one of them."""
