"""The scale of pseudo-depth: along each pixel's ray, and in what is rendered of it."""

from __future__ import annotations

NEAR, FAR = 0.0, 2.0
"""Where rays begin and end."""
