"""The JSON of `decomo-view`'s page: the points with names and colours, and their tracks through the whole clip."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.tracks import Tracks
from decomotion.times import steady_times

FORMAT, VERSION = "decomotion.points", 1
MOST_POINTS = 20_000
"""That the page opens."""
MOST = 10_000_000
"""Frames, pixels of a side and frames a second that a clip may be said to have, so that a few bytes take no memory."""
COLOUR = "#f73e73"
_DECIMALS = 4


def check(number: int, frames: npt.NDArray[np.int64], about: About) -> None:
    """`TracksFileError` where frames are missing, or there are too many points for the page."""
    if number > MOST_POINTS:
        raise TracksFileError(f"the page takes {MOST_POINTS} points at once, but there are {number}; write npz or csv")
    num_frames = about.length or len(frames)
    if frames.tolist() != list(range(num_frames)):
        raise TracksFileError(f"the page's JSON holds all {num_frames} frames of the clip in order; give such tracks")


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where the clip's size or rate is not known."""
    number, num_frames = tracks.occluded.shape
    colours = about.colours or [COLOUR] * number
    points = [
        {
            **{"name": name, "colour": colour, "t": int(t), "x": _rounded(x), "y": _rounded(y)},
            "tracks": _rounded(tracks.xy[row]),
            "occlusion": _rounded(tracks.occlusion[row]),
            "occluded": tracks.occluded[row].tolist(),
            **({} if tracks.error is None else {"error": _rounded(tracks.error[row])}),
        }
        for row, (name, colour, (t, x, y)) in enumerate(zip(about.names(number), colours, tracks.queries, strict=True))
    ]
    clip = {"name": about.name, "num_frames": num_frames, "width": about.width, "height": about.height}
    content = {"format": FORMAT, "version": VERSION, "clip": clip | {"fps": about.rate}, "points": points}
    path.write_text(json.dumps(content, separators=(",", ":")) + "\n", encoding="utf-8")


def read(path: Path) -> tuple[Tracks, About]:
    """Raises `TracksFileError` where the file is no such JSON, of a newer version, or has points without tracks."""
    try:
        content = json.loads(path.read_bytes())
        if content["format"] != FORMAT:
            raise ValueError("another format")
        version, clip, points = content["version"], content["clip"], content["points"]
        if version != VERSION:
            raise TracksFileError(f"{path} has version {version}, but this reads {VERSION}; upgrade, or save it as npz")
        sizes = [clip[key] for key in ("num_frames", "height", "width")]
        if any(type(size) is not int or not 1 <= size <= MOST for size in sizes) or not 1 / MOST <= clip["fps"] <= MOST:
            raise ValueError("no clip")
        length, height, width = sizes
        rows = {key: [point[key] for point in points] for key in ("tracks", "occlusion", "occluded", "name", "colour")}
        tracks = Tracks(
            _array(rows["tracks"], (len(points), length, 2)),
            _array(rows["occluded"], (len(points), length)).astype(bool),
            _array(rows["occlusion"], (len(points), length)),
            _array([[point["t"], point["x"], point["y"]] for point in points], (len(points), 3)),
            np.arange(length),
            (height, width),
            steady_times(length, float(clip["fps"])),
            error=_error(points, length),
        )
    except TracksFileError:
        raise
    except (OSError, ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise TracksFileError(
            f"{path} is not the JSON of points with their tracks that decomo-view's page saves; save it there again"
        ) from error
    about = About(
        fps=float(clip["fps"]),
        length=length,
        name=str(clip.get("name", "")) or About.name,
        points=tuple(str(name) for name in rows["name"]),
        colours=tuple(str(colour) for colour in rows["colour"]),
    )
    return tracks, about


def _error(points: Sequence[dict[str, Any]], length: int) -> npt.NDArray[np.float32] | None:
    """[point, frame]; None where not all points say it, as in older files."""
    told = [point["error"] for point in points if "error" in point]
    return _array(told, (len(points), length)) if points and len(told) == len(points) else None


def _rounded(values: Any) -> Any:
    return np.round(np.asarray(values, np.float64), _DECIMALS).tolist()


def _array(values: list[Any], shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    array = np.array(values, np.float64).reshape(shape if not values else np.shape(values))
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"no numbers of the shape {shape}")
    with np.errstate(over="ignore"):  # places beyond float32 are infinitely far
        return array.astype(np.float32)
