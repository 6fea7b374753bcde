"""Jobs: tasks of a batch, each of its own processes, on this machine or on a Ray cluster. No torch."""
