"""What was measured as named arrays with their units: what every file and picture is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.measure.strain import Strain

NONE = "1"
"""Unit of a number without one."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """Values of one kind."""

    name: str
    unit: str
    values: npt.NDArray[Any]
    """Of the shape of all others that it stands beside; nan where nothing is known."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What stands in one file."""

    keys: tuple[Quantity, ...]
    """What tells the rows apart: point, frame, time, place."""
    quantities: tuple[Quantity, ...]
    settings: dict[str, Any]
    """How it was measured, for files that hold it."""

    def named(self, name: str) -> Quantity:
        """The quantity of that name."""
        return next(each for each in self.quantities if each.name == name)


def plane(name: str, unit: str, values: npt.NDArray[np.floating], length: str) -> list[Quantity]:
    """A vector's x and y, and how long it is, under the name `length`; values [..., 2]."""
    parts = [Quantity(f"{name}_{axis}", unit, values[..., number]) for number, axis in enumerate("xy")]
    return [*parts, Quantity(length, unit, np.hypot(values[..., 0], values[..., 1]))]


def strains(strain: Strain) -> list[Quantity]:
    """All of a strain, by name."""
    tensors = {"green_lagrange": strain.green_lagrange, "small_strain": strain.small}
    parts = [
        Quantity(f"{name}_{axes}", NONE, values[..., number])
        for name, values in tensors.items()
        for number, axes in enumerate(("xx", "yy", "xy"))
    ]
    return [
        *parts,
        Quantity("principal_1", NONE, strain.principal[..., 0]),
        Quantity("principal_2", NONE, strain.principal[..., 1]),
        Quantity("principal_direction", "deg", strain.direction),
        Quantity("rotation", "deg", strain.rotation),
        Quantity("area_change", NONE, strain.area_change),
    ]
