"""Tracks in the layouts of other trackers' code.

CoTracker: `tracks` [1, T, N, 2] in pixels with centres at integers, `visibility` [1, T, N] bool.
TAP-Vid: its raster spans 0 to 256 in x and in y whatever the image's size; queries are (t, y, x).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.tracks import Tracks
from decomotion.tracker_files import COTRACKER_VISIBLE

RASTER_SIZE = 256


@dataclass(frozen=True, eq=False)
class TapVid:
    """Tracks as TAP-Vid's code takes them."""

    query_points: npt.NDArray[np.float32]
    """[N, 3], (t, y, x), raster."""
    tracks: npt.NDArray[np.float32]
    """[N, M, 2], (x, y), raster."""
    occluded: npt.NDArray[np.bool_]
    """[N, M]."""


def to_cotracker(tracks: Tracks) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """`(tracks [1, M, N, 2], visibility [1, M, N])`, M being the frames of `tracks`."""
    return tracks.xy.swapaxes(0, 1)[None].copy(), ~tracks.occluded.T[None]


def from_cotracker(
    tracks: npt.ArrayLike, visibility: npt.ArrayLike, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None
) -> Tracks:
    """The inverse of `to_cotracker`; `visibility` may be a probability, which then becomes the score.

    Args:
        tracks: [1, M, N, 2] or [M, N, 2], pixels.
        visibility: [1, M, N] or [M, N], bool or in [0, 1]: visible above `COTRACKER_VISIBLE`.
        queries: [N, 3], (t, x, y).
        frames: [M]; default: 0 .. M - 1.

    Raises `TracksFileError` where they are no numbers, or the shapes do not go together.
    """
    given = [_numbers("CoTracker", array) for array in (tracks, visibility, queries)]
    with np.errstate(over="ignore"):
        xy, seen, asked = (array.astype(np.float32) for array in given)
    xy = xy[0] if xy.ndim == 4 and len(xy) == 1 else xy
    seen = seen[0] if seen.ndim == 3 and len(seen) == 1 else seen
    if xy.ndim != 3 or xy.shape[2] != 2 or seen.shape != xy.shape[:2] or asked.shape != (xy.shape[1], 3):
        raise TracksFileError(
            f"CoTracker's layout is tracks [1, T, N, 2], visibility [1, T, N] and queries [N, 3]; got "
            f"{list(given[0].shape)}, {list(given[1].shape)} and {list(asked.shape)}"
        )
    numbers = np.arange(len(xy)) if frames is None else _numbers("CoTracker", frames)
    if numbers.shape != (len(xy),) or (len(xy) and numbers.dtype.kind not in "iu"):
        raise TracksFileError(
            f"frames must name each of the {len(xy)} frames of the tracks by a whole number; got {numbers.dtype} of "
            f"{list(numbers.shape)}"
        )
    occluded = ~(seen.T > COTRACKER_VISIBLE)
    return Tracks(xy.swapaxes(0, 1).copy(), occluded, 1 - seen.T, asked, numbers.astype(np.int64))


def to_tapvid(tracks: Tracks, width: int, height: int) -> TapVid:
    """`tracks`, in pixels of a clip of that size, as TAP-Vid has them."""
    points = pixels_to_raster(tracks.queries[:, 1:], width, height)[:, ::-1]
    return TapVid(
        np.concatenate([tracks.queries[:, :1], points], axis=1).astype(np.float32),
        pixels_to_raster(tracks.xy, width, height).astype(np.float32),
        tracks.occluded.copy(),
    )


def from_tapvid(answer: TapVid, width: int, height: int) -> Tracks:
    """The inverse of `to_tapvid`: all frames from 0, scores 0 and 1.

    Raises `TracksFileError` where they are no numbers, or the shapes do not go together.
    """
    points, tracks, hidden = (
        _numbers("TAP-Vid", array) for array in (answer.query_points, answer.tracks, answer.occluded)
    )
    if hidden.ndim != 2 or tracks.shape != (*hidden.shape, 2) or points.shape != (len(hidden), 3):
        raise TracksFileError(
            f"TAP-Vid's layout is query_points [N, 3], tracks [N, T, 2] and occluded [N, T]; got {list(points.shape)}, "
            f"{list(tracks.shape)} and {list(hidden.shape)}"
        )
    place = raster_to_pixels(points[:, :0:-1], width, height)
    queries = np.concatenate([points[:, :1], place], axis=1).astype(np.float32)
    xy = raster_to_pixels(tracks, width, height).astype(np.float32)
    occluded = hidden.astype(bool)
    return Tracks(xy, occluded, occluded.astype(np.float32), queries, np.arange(occluded.shape[1]))


def _numbers(layout: str, array: npt.ArrayLike) -> npt.NDArray[Any]:
    """The array; `TracksFileError` where it is of something else, or its rows are not equally long."""
    try:
        given = np.asarray(array)
    except ValueError as error:
        raise TracksFileError(f"{layout}'s layout is of arrays, but not all rows of one are equally long") from error
    if given.dtype.kind not in "biuf":
        raise TracksFileError(f"{layout}'s layout is of numbers; got {given.dtype}")
    return given


def raster_to_pixels(xy: npt.ArrayLike, width: int, height: int) -> npt.NDArray[np.float64]:
    """[..., 2] raster (x, y) to [..., 2] (x, y) in pixels of a video of that size."""
    return np.asarray(xy, dtype=np.float64) * (np.array([width, height]) / RASTER_SIZE) - 0.5


def pixels_to_raster(xy: npt.ArrayLike, width: int, height: int) -> npt.NDArray[np.float64]:
    """[..., 2] (x, y) in pixels of a video of that size to [..., 2] raster (x, y)."""
    return (np.asarray(xy, dtype=np.float64) + 0.5) * (RASTER_SIZE / np.array([width, height]))
