"""What the benchmark programs share: clips with ground truth, rows of a series, records, tracking by flow."""
