"""What is drawn on frames, and what is carried: shapes of objects.

Coordinates are pixels with centres at whole numbers; formats whose pixels begin at whole numbers convert.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

Mask = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]


class Kind(StrEnum):
    """What a shape is."""

    MASK = "mask"
    POLYGON = "polygon"
    BOX = "box"
    POINTS = "points"

    @property
    def is_region(self) -> bool:
        """Whether its pixels are the object's."""
        return self in (Kind.MASK, Kind.POLYGON)


@dataclass(frozen=True, eq=False)
class Shape:
    """One object in one frame; an object may have shapes of several kinds."""

    thing: int
    """Index of the object in `Annotation.things`."""
    frame: int
    kind: Kind
    mask: Mask | None = None
    """[H, W], of a region."""
    polygons: Sequence[Floats] = ()
    """[P, 2] each, of a polygon that was drawn; of one that was carried they are the outlines of its mask."""
    xy: Floats = field(default_factory=lambda: np.empty((0, 2)))
    """[P, 2], of points, nan where one is not told; of a box [2, 2], its upper left and lower right corner."""
    occluded: Mask = field(default_factory=lambda: np.empty(0, bool))
    """[P], of points: told, but hidden."""
    confidence: float = 1.0
    """From 0 to 1; 1 of what was drawn."""


@dataclass(frozen=True)
class Thing:
    """An object."""

    id: int | str
    """In its format: kept."""
    name: str
    """Its class, or what else people call it."""
    points: tuple[str, ...] = ()
    """Names of its keypoints."""
    source: Mapping[str, Any] = field(default_factory=dict)
    """What its format wants to have back."""


@dataclass(frozen=True, eq=False)
class Annotation:
    """What was drawn on frames of a clip."""

    size: tuple[int, int]
    """(height, width) of the frames."""
    things: tuple[Thing, ...]
    shapes: tuple[Shape, ...]
    source: Any = None
    """What the format wants to have back."""

    @property
    def frames(self) -> list[int]:
        """Those with a shape, rising."""
        return sorted({shape.frame for shape in self.shapes})
