"""Which points are of one object, or animal, for tools that want to know: their names say so, as OBJECT.PART.

That is how keypoints of several objects are called when they are read (`keypoints.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import unique_names


@dataclass(frozen=True, eq=False)
class Objects:
    """O objects, and the P parts that any of them has."""

    names: list[str]
    """[O]."""
    parts: list[str]
    """[P]."""
    rows: npt.NDArray[np.int64]
    """[O, P], the point that is this part of this object; -1 where it has none."""

    @property
    def several(self) -> bool:
        """Whether there are two or more."""
        return len(self.names) > 1

    def arranged(self, values: npt.NDArray[Any], nothing: Any) -> npt.NDArray[Any]:
        """[O, P, ...] of what is known of the points [N, ...]; `nothing` where there is no point."""
        filler = np.full_like(values[:1], nothing)
        return np.concatenate([values, filler])[self.rows]

    def mean(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """[O, ...], of each object the mean of what is known of its points [N, ...]."""
        return np.stack([values[row[row >= 0]].mean(axis=0) for row in self.rows])


def objects_of(about: About, number: int) -> Objects:
    """By the names of the `number` points.

    All are one object, unless each is OBJECT.PART, there are several objects, and they have half of the parts or more.
    """
    names = unique_names(about.names(number))
    split = [name.partition(".") for name in names]
    owners = list(dict.fromkeys(owner for owner, _, _ in split))
    parts = list(dict.fromkeys(part for _, _, part in split))
    told = all(owner and part for owner, _, part in split) and len(owners) * len(parts) <= 2 * number
    if len(owners) < 2 or not told:
        return Objects([about.name], names, np.arange(number)[None])
    rows = np.full((len(owners), len(parts)), -1)
    for row, (owner, _, part) in enumerate(split):
        rows[owners.index(owner), parts.index(part)] = row
    return Objects(owners, parts, rows)
