"""napari's Tracks layer as a table: columns track_id, t, y, x are its data, the others its features.

    data = numpy.loadtxt("tracks.csv", delimiter=",", skiprows=1)
    viewer.add_tracks(data[:, :4], features={"occlusion": data[:, 4], "occluded": data[:, 5], "error": data[:, 6]})

Pixel centres are at whole numbers; `error`, in pixels, is absent where it is not known. A layer joins the vertices of
a track: hidden ones are there too, and marked, but none beyond the frame, which the view would have to hold.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import in_frame, in_order
from decomo_runtime.tracks import Tracks

FIRST_FRAME = 0
_VERTEX = {"track_id": "%d", "t": "%d", "y": "%.4f", "x": "%.4f"}
_FEATURES = {"occlusion": "%.4f", "occluded": "%d", "error": "%.4f"}


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where no point is in the frame."""
    data, features = layer(tracks, about)
    with open(path, "w", encoding="ascii", newline="\n") as file:
        formats = _VERTEX | {name: _FEATURES[name] for name in features}
        file.write(",".join(formats) + "\n")
        np.savetxt(file, np.column_stack([data, *features.values()]), fmt=",".join(formats.values()))


def layer(tracks: Tracks, about: About) -> tuple[npt.NDArray[np.float64], dict[str, npt.NDArray[Any]]]:
    """Vertices [K, 4] of (track_id, t, y, x) and features [K] by name.

    Where the clip's size is known, there is none beyond the frame. Raises `TracksFileError` where there is none at all.
    """
    tracks = in_order(tracks)
    about = replace(about, size=about.size or tracks.size)
    kept = np.isfinite(tracks.xy).all(axis=-1) if about.size is None else in_frame(tracks, about)
    if not kept.any():
        raise TracksFileError("no point is in the frame at any time, so that there is nothing to write")
    point, column = np.nonzero(kept)
    x, y = tracks.xy[point, column].astype(np.float64).T
    data = np.column_stack([point, about.numbers(tracks.frames, FIRST_FRAME)[column], y, x])
    of_points = {"occlusion": tracks.occlusion, "occluded": tracks.occluded, "error": tracks.error}
    features = {name: values[point, column] for name, values in of_points.items() if values is not None}
    return data.astype(np.float64), features
