"""Maps of displacement and strain: for each node of a raster over the frame of reference, of the gauge around it.

What a moving object owns and what the static scene owns are measured apart, so that no gauge reaches across the rim of
an object. A node in sight is measured by nodes in sight alone; a hidden one by all around it, and is marked. Where
the nodes of a gauge are so far from any plane that it must be torn, as where a leg passes another, there is no strain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomo_runtime.errors import MeasureError
from decomo_runtime.layers import pixel_queries
from decomo_runtime.measure.following import (
    AnyTracker,
    MeasureSettings,
    check_reference,
    follow,
    in_blocks,
    wanted_frames,
)
from decomo_runtime.measure.gradient import TORN, gradients_of_raster
from decomo_runtime.measure.points import described
from decomo_runtime.measure.quantities import NONE, Measured, Quantity, plane, strains
from decomo_runtime.measure.strain import Strain, strain_of
from decomo_runtime.regions import SPACING
from decomotion.frames import AnyFrames

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

GAUGE = 32.0
"""Pixels, of the side of the square that a strain is of."""
BLOCK = 16
"""Frames that are asked for at once."""


@dataclass(frozen=True, eq=False)
class Raster:
    """The nodes [h, w] that a map is of, in the frame of reference."""

    reference: int
    queries: npt.NDArray[np.float32]
    """[h, w, 3], rows of (t, x, y)."""
    inside: Mask
    """[h, w], which of them are measured."""
    on_object: Mask
    """[h, w]"""
    step: npt.NDArray[np.float64]
    """[2], pixels between nodes along x and y."""
    radius: tuple[int, int]
    """Nodes of a gauge on either side, along x and y."""

    @property
    def gauge(self) -> tuple[float, float]:
        """Pixels from the first node of a gauge to its last, along x and y: what comes nearest to what was asked."""
        along, down = (2 * radius * float(step) for radius, step in zip(self.radius, self.step, strict=True))
        return along, down


@dataclass(frozen=True, eq=False)
class StrainMap:
    """Of a frame, against that of reference, on a raster [h, w] over the latter; nan where nothing is measured."""

    raster: Raster
    frame: int
    time: float
    """Seconds at which the frame was recorded."""
    xy: Floats
    """[h, w, 2], pixels: where the nodes are in the frame."""
    displacement: Floats
    """[h, w, 2], in the scale's unit; x goes right, y down."""
    deformation: Floats
    """[h, w, 2, 2], the deformation gradient."""
    strain: Strain
    """[h, w]"""
    residual: Floats
    """[h, w], root mean square, in the scale's unit, of what the deformation gradient leaves of a gauge's nodes."""
    hidden: Mask
    """[h, w]"""
    settings: MeasureSettings

    def measured(self) -> Measured:
        """Arrays [h, w] by name."""
        unit, queries = self.settings.scale.unit, self.raster.queries
        keys = (Quantity("reference_x", "px", queries[..., 1]), Quantity("reference_y", "px", queries[..., 2]))
        quantities = (
            Quantity("x", "px", self.xy[..., 0]),
            Quantity("y", "px", self.xy[..., 1]),
            Quantity("occluded", NONE, self.hidden),
            *plane("displacement", unit, self.displacement, "distance"),
            *strains(self.strain),
            Quantity("residual", unit, self.residual),
        )
        facts = {
            "frame": self.frame,
            "reference": self.raster.reference,
            "time": self.time,
            "gauge_px": list(self.raster.gauge),
        }
        return Measured(keys, quantities, described(self.settings) | facts)


def raster_over(
    tracker: AnyTracker,
    reference: int,
    *,
    spacing: float = SPACING,
    gauge: float = GAUGE,
    region: Mask | None = None,
) -> Raster:
    """Nodes about every `spacing` pixels of frame `reference`, where `region` [H, W] is True.

    `gauge` is the side, in pixels, of the squares that strains are of. `MeasureError` where frame, sizes or region are
    none of the clip's.
    """
    check_reference(reference, tracker)
    facts = tracker.facts
    full = np.array([facts.height, facts.width])
    if region is not None and region.shape != (facts.height, facts.width):
        raise MeasureError(
            f"the region is a mask of {list(region.shape)}, but the clip's frames are [{facts.height}, {facts.width}]; "
            "give one of their size"
        )
    if not 1 <= spacing <= full.min() / 4:
        raise MeasureError(f"--spacing {spacing:g} must be from 1 pixel to a quarter of the frame")
    if not 2 * spacing <= gauge <= full.min():
        raise MeasureError(
            f"--gauge {gauge:g} must be at least twice the spacing of {spacing:g} pixels, and no more than the frame"
        )
    size = np.rint(full / spacing).astype(int)
    height, width = size.tolist()
    queries = pixel_queries(reference, (height, width), facts)
    step = (full / size)[::-1]
    across, down = np.maximum(1, np.rint(gauge / (2 * step))).astype(int).tolist()
    column, row = np.floor(queries[:, 1:] + 0.5).astype(np.int64).T
    inside = np.ones(len(queries), bool) if region is None else region[row, column]
    if not inside.any():
        raise MeasureError(f"no node of a raster of {spacing:g} pixels lies in the region; give a smaller --spacing")
    on_object = tracker.on_object(queries)
    shape = height, width
    return Raster(
        reference,
        queries.reshape(*shape, 3),
        inside.reshape(shape),
        on_object.reshape(shape),
        step,
        (across, down),
    )


def measure_maps(
    tracker: AnyTracker,
    raster: Raster,
    *,
    frames: npt.ArrayLike | None = None,
    clip: AnyFrames | None = None,
    settings: MeasureSettings | None = None,
) -> Iterator[StrainMap]:
    """Displacement and strain of each frame, one at a time, against the raster's frame of reference.

    What else is given and raised is that of `measure_points`.
    """
    settings = MeasureSettings() if settings is None else settings
    numbers = wanted_frames(frames, tracker)
    times, lengths = settings.times(tracker), settings.lengths(tracker)
    asked = raster.queries[raster.inside]
    with tqdm(total=len(numbers), desc="measure", leave=False, disable=not settings.progress) as bar:
        for block in in_blocks(numbers, BLOCK):
            tracks = follow(tracker, asked, block, clip)
            for column, frame in enumerate(block.tolist()):
                xy = np.full((*raster.inside.shape, 2), np.nan)
                xy[raster.inside] = tracks.xy[:, column]
                hidden = ~raster.inside
                hidden[raster.inside] = tracks.occluded[:, column]
                yield _map_of(raster, frame, float(times[frame]), xy, hidden, lengths, settings)
                bar.update()


def _map_of(
    raster: Raster, frame: int, time: float, xy: Floats, hidden: Mask, lengths: Floats, settings: MeasureSettings
) -> StrainMap:
    displacement = (xy - raster.queries[..., 1:]) * lengths
    deformation = np.full((*hidden.shape, 2, 2), np.nan)
    residual = np.full(hidden.shape, np.nan)
    known = np.isfinite(xy).all(-1)
    for own in (raster.on_object, ~raster.on_object):
        for wanted, counted in ((~hidden, ~hidden), (hidden, np.ones_like(hidden))):
            at = known & own & wanted
            if at.any():
                found = gradients_of_raster(displacement, raster.step * lengths, raster.radius, known & own & counted)
                deformation[at], residual[at] = found.deformation[at], found.residual[at]
    deformation[residual > TORN * (raster.gauge * lengths).min()] = np.nan
    return StrainMap(
        raster, frame, time, xy, displacement, deformation, strain_of(deformation), residual, hidden, settings
    )
