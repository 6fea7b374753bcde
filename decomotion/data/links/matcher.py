"""What a matcher is, and its matches between two frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from decomotion.clip import Clip


@dataclass(frozen=True)
class Matches:
    """Where the cells of one frame are in another."""

    displacement: npt.NDArray[np.float32]
    """[h, w, 2]: (x, y) in cells; the raster of cells covers the frame."""
    trusted: npt.NDArray[np.bool_]
    """[h, w]: mutual, and supported by what is around."""


PairMatcher = Callable[[int, int], tuple[Matches, Matches]]
"""Of two frames the matches from the first to the second, and back."""


@runtime_checkable
class Matcher(Protocol):
    """Anything that finds places of one frame again in another."""

    def describe(self, clip: Clip, folder: Path, progress: bool) -> PairMatcher:
        """Looks at all frames of a clip; what it returns matches any two of them.

        What is too large for the memory is kept in `folder`, which is empty and goes when the matches are made.
        """
        ...

    def seconds(self, clip: Clip) -> tuple[float, float]:
        """What a frame takes on this machine, and a pair of frames."""
        ...
