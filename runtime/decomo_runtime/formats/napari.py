"""napari's Tracks layer as a table: columns track_id, t, y, x are its data, the others its features.

    data = numpy.loadtxt("tracks.csv", delimiter=",", skiprows=1)
    viewer.add_tracks(data[:, :4], features={"occlusion": data[:, 4], "occluded": data[:, 5]})

Pixel centres are at whole numbers. A layer joins the vertices of a track: hidden ones are there too,
and marked.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import in_order
from decomo_runtime.tracks import Tracks

FIRST_FRAME = 0
_FORMATS = {"track_id": "%d", "t": "%d", "y": "%.4f", "x": "%.4f", "occlusion": "%.4f", "occluded": "%d"}


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where there is nothing to write."""
    data, features = layer(tracks, about)
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(",".join(_FORMATS) + "\n")
        np.savetxt(file, np.column_stack([data, *features.values()]), fmt=",".join(_FORMATS.values()))


def layer(tracks: Tracks, about: About) -> tuple[npt.NDArray[np.float64], dict[str, npt.NDArray[Any]]]:
    """Vertices [K, 4] of (track_id, t, y, x) and features [K] by name. A place that is not finite has no vertex."""
    tracks = in_order(tracks)
    point, column = np.nonzero(np.isfinite(tracks.xy).all(axis=-1))
    x, y = tracks.xy[point, column].astype(np.float64).T
    data = np.column_stack([point, about.numbers(tracks.frames, FIRST_FRAME)[column], y, x])
    return data.astype(np.float64), {
        "occlusion": tracks.occlusion[point, column],
        "occluded": tracks.occluded[point, column],
    }
