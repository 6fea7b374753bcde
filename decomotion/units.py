"""The unit of length: a pixel of a frame whose longer side is 256.

Thresholds, losses and errors are in units, so that they weigh the same at any resolution. Units have a raster as pixels
have: its centres lie at integers, and it covers the same image.
"""

from __future__ import annotations

from typing import TypeVar

LONGER_SIDE = 256
"""Of a frame, in units."""

Places = TypeVar("Places")
"""An array or a tensor of places, [..., 2]."""


def unit(*sides: float | int) -> float:
    """Length of a unit in pixels of a frame, or of a raster that covers it, from its sides, or the longer one alone."""
    return max(sides) / LONGER_SIDE


def to_units(xy: Places, *sides: float | int) -> Places:
    """Places (x, y) in pixels of a frame with these `sides`, as places in units."""
    return (xy + 0.5) / unit(*sides) - 0.5  # type: ignore[operator]


def from_units(xy: Places, *sides: float | int) -> Places:
    """Places (x, y) in units as places in pixels of a frame with these `sides`."""
    return (xy + 0.5) * unit(*sides) - 0.5  # type: ignore[operator]
