"""Displacement, velocity and acceleration of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decomo_runtime.measure.following import AnyTracker, MeasureSettings, follow_points, wanted_frames
from decomo_runtime.measure.quantities import NONE, Measured, Quantity, plane
from decomo_runtime.measure.smoothing import Derivatives, derivatives
from decomo_runtime.tracks import Tracks
from decomotion.frames import AnyFrames

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointMotion:
    """Of N points in M frames, in the scale's unit and seconds; x goes right, y down."""

    tracks: Tracks
    """Where they are, in pixels of the clip."""
    times: Floats
    """[M], seconds at which the frames were recorded."""
    displacement: Floats
    """[N, M, 2], from the frame of reference."""
    rates: Derivatives
    hidden: npt.NDArray[np.bool_]
    """[N, M], True where a point is hidden in the frame, or in that of reference."""
    reference: int | None
    """Frame; None: the query's own of each point."""
    settings: MeasureSettings

    def measured(self) -> Measured:
        """Arrays [N, M] by name."""
        unit, shape = self.settings.scale.unit, self.hidden.shape
        own = self.tracks.queries[:, :1].astype(np.int64) if self.reference is None else np.int64(self.reference)
        keys = (
            Quantity("point", NONE, np.broadcast_to(np.arange(shape[0])[:, None], shape)),
            Quantity("frame", NONE, np.broadcast_to(self.tracks.frames, shape)),
            Quantity("time", "s", np.broadcast_to(self.times, shape)),
        )
        quantities = [
            Quantity("reference", NONE, np.broadcast_to(own, shape)),
            Quantity("x", "px", self.tracks.xy[..., 0]),
            Quantity("y", "px", self.tracks.xy[..., 1]),
            Quantity("occluded", NONE, self.hidden),
            *plane("displacement", unit, self.displacement, "distance"),
            *rates(self.rates, unit),
        ]
        if self.tracks.error is not None:
            length = self.settings.scale.length
            quantities.append(Quantity("error", unit, self.tracks.error * length))
        return Measured(keys, tuple(quantities), described(self.settings))


def rates(found: Derivatives, unit: str) -> list[Quantity]:
    """Velocity and acceleration by name, and how far to trust them."""
    return [
        *plane("velocity", f"{unit}/s", found.velocity, "speed"),
        *plane("acceleration", f"{unit}/s^2", found.acceleration, "acceleration"),
        Quantity("velocity_gain", "1/s", found.gain),
        Quantity("frames_used", NONE, found.used),
    ]


def described(settings: MeasureSettings) -> dict[str, object]:
    """For files."""
    return {
        "length_of_a_pixel": settings.scale.length,
        "unit_of_length": settings.scale.unit,
        "fps": settings.fps,
        "smoothing": {
            "kind": "local polynomial, least squares (Savitzky-Golay)",
            "window": settings.smoothing.window,
            "order": settings.smoothing.order,
        },
        "axes": "x right, y down; angles from x towards y, clockwise as seen",
    }


def measure_points(
    tracker: AnyTracker,
    queries: npt.ArrayLike,
    *,
    frames: npt.ArrayLike | None = None,
    reference: int | None = None,
    clip: AnyFrames | None = None,
    settings: MeasureSettings | None = None,
) -> PointMotion:
    """How `queries` [N, 3], rows of (t, x, y), move.

    Args:
        tracker: the model.
        queries: points of the clip.
        frames: [M], rising; default: all.
        reference: frame against which displacements are; default: each query's own.
        clip: RGB, uint8 [T, H, W, 3], the whole clip: points in sight are refined on it; default: the model's answers.
        settings: scale, frame rate and smoothing.

    Raises `QueryError` and `MeasureError` where arguments are malformed, `RefinementError` where `clip` is another.
    """
    settings = MeasureSettings() if settings is None else settings
    numbers = wanted_frames(frames, tracker)
    times = settings.times(tracker)[numbers]
    followed = follow_points(tracker, queries, numbers, reference, clip, settings.progress)
    lengths = settings.lengths(tracker)
    moved = (followed.tracks.xy.astype(np.float64) - followed.reference[:, None]) * lengths
    rates_found = derivatives(moved, times, followed.tracks.occluded, settings.smoothing)
    return PointMotion(followed.tracks, times, moved, rates_found, followed.hidden, reference, settings)
