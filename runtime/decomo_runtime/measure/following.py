"""Points followed for a measurement: by the model, and in the clip's own pixels where these are given."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomo_runtime import dense
from decomo_runtime.errors import MeasureError
from decomo_runtime.measure.smoothing import Smoothing
from decomo_runtime.measure.units import Scale, recorded_times
from decomo_runtime.queries import check_frames, check_queries
from decomo_runtime.refinement import refine
from decomo_runtime.tracks import Tracks
from decomotion.frames import AnyFrames

PIECE = 2048
"""Points that are followed at once."""


class AnyTracker(dense.AnyTracker, Protocol):
    """What is asked of a `Tracker`."""

    @property
    def times(self) -> npt.NDArray[np.float64]:
        """[T], seconds of each frame of the clip."""
        ...

    def on_object(self, queries: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which of `queries` [N, 3] a moving object owns."""
        ...


@dataclass(frozen=True)
class MeasureSettings:
    """How is measured."""

    scale: Scale = Scale()  # noqa: RUF009
    fps: float | None = None
    """Frames a second as the camera recorded them; None: the clip's own times."""
    smoothing: Smoothing = Smoothing()  # noqa: RUF009
    """Of velocity and acceleration along time."""
    progress: bool = False
    """Whether to show it."""

    def times(self, tracker: AnyTracker) -> npt.NDArray[np.float64]:
        """[T], seconds at which each frame of the clip was recorded."""
        return recorded_times(tracker.times, tracker.facts.fps, self.fps)

    def lengths(self, tracker: AnyTracker) -> npt.NDArray[np.float64]:
        """[2], how long a pixel is along x and y."""
        return self.scale.lengths(tracker.facts.pixel_aspect)


@dataclass(frozen=True, eq=False)
class Followed:
    """Points in the frames asked for and in the frame that they are compared with."""

    tracks: Tracks
    """Of the frames asked for."""
    reference: npt.NDArray[np.float64]
    """[N, 2], pixels: places in the frame of reference."""
    hidden: npt.NDArray[np.bool_]
    """[N, M], True where a point is hidden in the frame, or in that of reference."""


def check_reference(reference: int, tracker: AnyTracker) -> int:
    """`MeasureError` where the clip has no such frame."""
    last = tracker.facts.num_frames - 1
    if not isinstance(reference, int | np.integer) or not 0 <= reference <= last:
        raise MeasureError(f"--reference {reference} is no frame of the clip; give one within 0 .. {last}")
    return reference


def wanted_frames(frames: npt.ArrayLike | None, tracker: AnyTracker) -> npt.NDArray[np.int64]:
    """[M], checked. `MeasureError` unless they rise: velocities are taken along them."""
    numbers = check_frames(frames, tracker.facts.num_frames)
    if len(numbers) == 0 or (np.diff(numbers) <= 0).any():
        raise MeasureError("frames to measure in must be at least one, in rising order")
    return numbers


def follow_points(
    tracker: AnyTracker,
    queries: npt.ArrayLike,
    frames: npt.NDArray[np.int64],
    reference: int | None,
    clip: AnyFrames | None,
    progress: bool,
) -> Followed:
    """`queries` [N, 3] in `frames` [M] against frame `reference`; None: each against its own place.

    They are refined on the frames of `clip`, where given.
    """
    asked = check_queries(queries, tracker.facts)
    if len(asked) == 0:
        raise MeasureError("there is no point to measure; give at least one, or leave out --on")
    wanted = frames if reference is None else np.union1d(frames, [check_reference(reference, tracker)])
    pieces = [asked[begin : begin + PIECE] for begin in range(0, len(asked), PIECE)]
    with tqdm(pieces, "follow", leave=False, disable=not progress) as bar:
        parts = [follow(tracker, piece, wanted, clip) for piece in bar]
    tracks = parts[0] if len(parts) == 1 else _joined(parts)
    columns = np.searchsorted(wanted, frames)
    kept = Tracks(
        tracks.xy[:, columns],
        tracks.occluded[:, columns],
        tracks.occlusion[:, columns],
        asked,
        frames,
        error=None if tracks.error is None else tracks.error[:, columns],
    )
    if reference is None:
        return Followed(kept, asked[:, 1:].astype(np.float64), kept.occluded)
    column = int(np.searchsorted(wanted, reference))
    hidden = kept.occluded | tracks.occluded[:, column, None]
    return Followed(kept, tracks.xy[:, column].astype(np.float64), hidden)


def follow(
    tracker: AnyTracker, queries: npt.NDArray[np.float32], frames: npt.NDArray[np.int64], clip: AnyFrames | None
) -> Tracks:
    """`queries` [N, 3] in `frames` [M], refined on the frames of `clip`, where given."""
    tracks = tracker.track(queries, frames)
    return tracks if clip is None else refine(tracker, tracks, clip)


def in_blocks(frames: npt.NDArray[np.int64], size: int) -> Iterator[npt.NDArray[np.int64]]:
    """`frames`, so many at once."""
    yield from (frames[begin : begin + size] for begin in range(0, len(frames), size))


def _joined(parts: list[Tracks]) -> Tracks:
    errors = [each.error for each in parts if each.error is not None]
    return Tracks(
        np.concatenate([each.xy for each in parts]),
        np.concatenate([each.occluded for each in parts]),
        np.concatenate([each.occlusion for each in parts]),
        np.concatenate([each.queries for each in parts]),
        parts[0].frames,
        error=np.concatenate(errors) if len(errors) == len(parts) else None,
    )
