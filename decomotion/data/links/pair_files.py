"""Arrays of ordered pairs of frames, a file `<first>_<second>.npy` each, in a folder of a partial stage."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.data.stages import readable, write_array

Couple = tuple[int, int]
"""Two frames, the earlier one first."""


@dataclass(frozen=True)
class PairFiles:
    """What an interrupted run has written is found again; half a file counts as none."""

    folder: Path

    def have(self, couple: Couple) -> bool:
        """Whether both ways are there."""
        return all(readable(self._file(*way)) for way in (couple, couple[::-1]))

    def write(self, first: int, second: int, values: npt.NDArray[Any]) -> None:
        """Keeps the array of frame `first` to frame `second`."""
        write_array(self._file(first, second), values)

    def read(self, first: int, second: int) -> npt.NDArray[Any]:
        """The array of frame `first` to frame `second`."""
        return np.load(self._file(first, second))

    def _file(self, first: int, second: int) -> Path:
        return self.folder / f"{first}_{second}.npy"
