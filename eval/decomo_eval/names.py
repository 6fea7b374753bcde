"""Names that the command offers, apart from what they stand for, so that its help loads nothing."""

from __future__ import annotations

BASELINES = ("chain", "direct", "multi")
"""Ways from flow to tracks (`baselines.py`)."""
FLOWS = ("dis", "raft-small", "raft-large")
"""Flow estimators, by the names of the trainer's configuration."""
DATASETS = ("tapvid", "folder", "pointodyssey", "egopoints", "dynamic-replica", "badja")
"""What is read (`readers/`)."""
RESOLUTIONS = ORIGINAL, STANDARD = "original", "256x256"
"""TAP-Vid's categories: the frames that a tracker works on, as they are stored or brought to that size."""
