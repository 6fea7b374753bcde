"""What was measured in files: csv with units in its header, npz, and OpenEXR for maps."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import MeasureError
from decomo_runtime.flow.exr import write_exr
from decomo_runtime.measure.quantities import Measured


def write_csv(measured: Measured, path: Path, _: float = 1.0) -> None:
    """A line for each value that has a place; columns are `name [unit]`, what is not known is empty."""
    columns = [*measured.keys, *measured.quantities]
    known = np.isfinite(measured.named("x").values).ravel()
    lines = zip(*(_cells(each.values.ravel()[known]) for each in columns), strict=True)
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([f"{each.name} [{each.unit}]" for each in columns])
        writer.writerows(lines)


def write_npz(measured: Measured, path: Path, _: float = 1.0) -> None:
    """An array for each quantity, by name; `units` and `settings` are JSON."""
    columns = [*measured.keys, *measured.quantities]
    arrays: dict[str, Any] = {each.name: each.values for each in columns}
    arrays["units"] = np.array(json.dumps({each.name: each.unit for each in columns}))
    arrays["settings"] = np.array(json.dumps(measured.settings))
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays)


def write_map_exr(measured: Measured, path: Path, pixel_aspect: float) -> None:
    """A channel for each quantity, float32; `units` and `settings` in the header are JSON."""
    channels = {each.name: each.values for each in measured.quantities}
    notes = {
        "units": json.dumps({each.name: each.unit for each in measured.quantities}),
        "settings": json.dumps(measured.settings),
    }
    write_exr(path, channels, pixel_aspect, notes)


Write = Callable[[Measured, Path, float], None]
TABLES: dict[str, Write] = {".csv": write_csv, ".npz": write_npz}
"""Of points and regions, by the file's ending."""
MAPS: dict[str, Write] = {"npz": write_npz, "csv": write_csv, "exr": write_map_exr}
"""Of maps, by the format's name, which is its ending; they take the pixel aspect too."""


def check_format(name: str) -> None:
    """`MeasureError` where its library is missing."""
    if name == "exr" and find_spec("OpenEXR") is None:
        raise MeasureError("OpenEXR is not installed; run: pip install 'decomotion[exr]', or take --format npz")


def _cells(values: npt.NDArray[Any]) -> list[str]:
    if values.dtype.kind in "biu":
        return [str(each) for each in values.astype(np.int64).tolist()]
    return [f"{each:.9g}" if np.isfinite(each) else "" for each in values.tolist()]
