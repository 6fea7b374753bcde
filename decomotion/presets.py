"""The presets by name; each is a file in `configs/`."""

from __future__ import annotations

PRESETS = ("cpu", "omnimotion", "paper")
AUTO, AUTO_PRESET = "auto", "cpu"
"""What leaves the choice to the toolkit, and what it takes: on a GPU too, where `paper` has not been tried yet."""
