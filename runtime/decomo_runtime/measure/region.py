"""Motion and strain of a region as a whole: the plane nearest to the displacements of all its points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import MeasureError
from decomo_runtime.measure.following import AnyTracker, MeasureSettings, follow_points, wanted_frames
from decomo_runtime.measure.gradient import LEAST_SHARE, TORN, gradients_of_points
from decomo_runtime.measure.points import described, rates
from decomo_runtime.measure.quantities import NONE, Measured, Quantity, plane, strains
from decomo_runtime.measure.smoothing import Derivatives, derivatives
from decomo_runtime.measure.strain import Strain, strain_of
from decomo_runtime.queries import check_queries
from decomo_runtime.tracks import Tracks
from decomotion.frames import AnyFrames

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RegionMotion:
    """Of a region in M frames, in the scale's unit and seconds; x goes right, y down."""

    tracks: Tracks
    """Of its N points, in pixels of the clip."""
    times: Floats
    """[M], seconds at which the frames were recorded."""
    middle: Floats
    """[M, 2], pixels."""
    displacement: Floats
    """[M, 2], of its middle, from the frame of reference."""
    rates: Derivatives
    """[1, M], of its middle."""
    deformation: Floats
    """[M, 2, 2], the deformation gradient; nan where the region is torn."""
    strain: Strain
    """[M]"""
    residual: Floats
    """[M], root mean square of the points' distances from what the deformation gradient says."""
    in_sight: Floats
    """[M], share of its points that are in sight, there and in the frame of reference."""
    hidden: npt.NDArray[np.bool_]
    """[M], True where too few are for a strain: there all its points count, as the model has them."""
    reference: int
    settings: MeasureSettings

    def measured(self) -> Measured:
        """Arrays [M] by name."""
        unit = self.settings.scale.unit
        keys = (Quantity("frame", NONE, self.tracks.frames), Quantity("time", "s", self.times))
        of_middle = self.rates
        derived = Derivatives(of_middle.velocity[0], of_middle.acceleration[0], of_middle.gain[0], of_middle.used[0])
        quantities = (
            Quantity("reference", NONE, np.full(len(self.times), self.reference)),
            Quantity("x", "px", self.middle[:, 0]),
            Quantity("y", "px", self.middle[:, 1]),
            Quantity("in_sight", NONE, self.in_sight),
            Quantity("occluded", NONE, self.hidden),
            *plane("displacement", unit, self.displacement, "distance"),
            *rates(derived, unit),
            *strains(self.strain),
            Quantity("residual", unit, self.residual),
        )
        return Measured(keys, quantities, described(self.settings) | {"points": len(self.tracks.queries)})


def measure_region(
    tracker: AnyTracker,
    queries: npt.ArrayLike,
    *,
    frames: npt.ArrayLike | None = None,
    reference: int | None = None,
    clip: AnyFrames | None = None,
    settings: MeasureSettings | None = None,
) -> RegionMotion:
    """How the region that `queries` [N, 3] fill moves and deforms; `reference` is by default the first query's frame.

    What else is given and raised is that of `measure_points`.
    """
    settings = MeasureSettings() if settings is None else settings
    numbers = wanted_frames(frames, tracker)
    times = settings.times(tracker)[numbers]
    queries = check_queries(queries, tracker.facts)
    if reference is None and len(queries):
        reference = int(queries[0, 0])
    followed = follow_points(tracker, queries, numbers, reference, clip, settings.progress)
    assert reference is not None, "follow_points refuses no points"
    lengths = settings.lengths(tracker)
    seen = ~followed.hidden
    share = seen.mean(0)
    hidden = share < LEAST_SHARE
    counted = seen | hidden
    start = followed.reference * lengths
    found = gradients_of_points(start, followed.tracks.xy.astype(np.float64) * lengths, counted)
    if not np.isfinite(gradients_of_points(start, start[:, None], np.ones((len(start), 1), bool)).deformation).all():
        raise MeasureError(
            f"the region has {len(start)} point{'s' * (len(start) != 1)}, of which a strain needs at least 4 that do "
            "not lie on a line; give a smaller --spacing, or a larger region"
        )
    torn = found.residual > TORN * np.ptp(start, axis=0).min()
    deformation = np.where(torn[:, None, None], np.nan, found.deformation)
    moved = found.moved[None]
    rates_found = derivatives(moved, times, hidden[None], settings.smoothing)
    middle = followed.reference.mean(0) + found.moved / lengths
    return RegionMotion(
        followed.tracks,
        times,
        middle,
        found.moved,
        rates_found,
        deformation,
        strain_of(deformation),
        found.residual,
        share,
        hidden,
        reference,
        settings,
    )
