"""An annotation of some frames, carried to all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from decomo_runtime.errors import AnnotationError
from decomo_runtime.footage import FramesByNumber, check_footage
from decomo_runtime.propagation.points import Placed, carry_box, carry_points
from decomo_runtime.propagation.regions import Carried, Regions
from decomo_runtime.propagation.shapes import Annotation, Kind, Shape

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker


@dataclass(frozen=True)
class Finding:
    """What is known of one object's shape in one frame."""

    frame: int
    thing: int
    kind: Kind
    drawn: bool
    """Whether it is what was drawn, unchanged."""
    confidence: float
    """From 0 to 1."""
    gap: bool
    """Whether it has no place in the frame."""
    in_sight: float
    """Share of its points in sight from an annotated frame."""
    disagreement: float | None
    """Between what two annotated frames say of what both have in sight: of a region 1 - IoU, of points and boxes
    pixels; None where no two have."""
    between: tuple[int, int] | None
    """The two frames."""


def propagate(
    tracker: Tracker, annotation: Annotation, frames: FramesByNumber | None = None
) -> Iterator[tuple[list[Shape], list[Finding]]]:
    """Yields of each frame of the clip the shapes of all objects that have a place in it, and what is known of all.

    What was drawn stays as it is. `frames` are the clip's own, uint8 [T, H, W, 3]: with them the rim of regions goes
    by their edges and colours. Raises `AnnotationError` where nothing was drawn, on frames of another size, or in a
    frame that the clip does not have, `OverlayError` where `frames` are of another clip.
    """
    if frames is not None:
        check_footage(frames, tracker.facts)
    _check(tracker, annotation)
    drawn = {(shape.frame, shape.thing, shape.kind): shape for shape in annotation.shapes}
    of_regions = sorted({shape.thing for shape in annotation.shapes if shape.kind.is_region})
    regions = _regions(tracker, annotation, of_regions, frames)
    numbers = np.arange(tracker.num_frames)
    placed = {
        (thing, kind): _placed(tracker, annotation, thing, kind, numbers)
        for thing, kind in sorted({(each.thing, each.kind) for each in annotation.shapes if not each.kind.is_region})
    }
    kinds = {shape.thing: shape.kind for shape in annotation.shapes if shape.kind.is_region}
    return _frame_by_frame(numbers.tolist(), drawn, of_regions, kinds, regions, placed)


def _frame_by_frame(
    numbers: list[int],
    drawn: dict[tuple[int, int, Kind], Shape],
    of_regions: list[int],
    kinds: dict[int, Kind],
    regions: Regions | None,
    placed: dict[tuple[int, Kind], Placed],
) -> Iterator[tuple[list[Shape], list[Finding]]]:
    for frame in numbers:
        shapes: list[Shape] = []
        findings: list[Finding] = []
        carried = [] if regions is None else regions.carry(frame)
        for thing, region in zip(of_regions, carried, strict=True):
            kind = kinds[thing]
            shapes += _kept(drawn, frame, thing, kind) or _of_region(region, thing, frame, kind)
            findings.append(_finding(region, frame, thing, kind, (frame, thing, kind) in drawn))
        for (thing, kind), each in placed.items():
            shapes += _kept(drawn, frame, thing, kind) or _of_points(each, thing, frame, kind)
            findings.append(_finding_of_points(each, frame, thing, kind, (frame, thing, kind) in drawn))
        yield shapes, findings


def _check(tracker: Tracker, annotation: Annotation) -> None:
    if not annotation.shapes:
        raise AnnotationError("nothing is drawn in what was given with --from; draw something on a frame of the clip")
    size = tracker.height, tracker.width
    if annotation.size != size:
        raise AnnotationError(
            f"the annotation is of frames of {annotation.size[1]}x{annotation.size[0]} but the clip is "
            f"{size[1]}x{size[0]}; give one that was drawn on this clip"
        )
    beyond = [frame for frame in annotation.frames if not 0 <= frame < tracker.num_frames]
    if beyond:
        raise AnnotationError(
            f"the annotation is of frame {beyond[0]} but the clip has frames 0 to {tracker.num_frames - 1}; give one "
            "that was drawn on this clip, or the frame behind an @"
        )


def _regions(
    tracker: Tracker, annotation: Annotation, things: list[int], frames: FramesByNumber | None
) -> Regions | None:
    if not things:
        return None
    drawn: dict[int, dict[int, np.ndarray]] = {}
    for shape in annotation.shapes:
        if shape.mask is not None:
            of_frame = drawn.setdefault(shape.frame, {})
            for other in of_frame.values():
                other &= ~shape.mask  # what is drawn later lies on top
            of_frame[things.index(shape.thing)] = shape.mask.copy()
    return Regions(tracker, drawn, frames)


def _placed(tracker: Tracker, annotation: Annotation, thing: int, kind: Kind, frames: np.ndarray) -> Placed:
    mine = [shape for shape in annotation.shapes if (shape.thing, shape.kind) == (thing, kind)]
    if kind == Kind.BOX:
        return carry_box(tracker, {shape.frame: shape.xy for shape in mine}, frames)
    return carry_points(tracker, {shape.frame: (shape.xy, shape.occluded) for shape in mine}, frames)


def _kept(drawn: dict[tuple[int, int, Kind], Shape], frame: int, thing: int, kind: Kind) -> list[Shape]:
    shape = drawn.get((frame, thing, kind))
    return [] if shape is None else [shape]


def _of_region(region: Carried, thing: int, frame: int, kind: Kind) -> list[Shape]:
    if not region.mask.any():
        return []
    return [Shape(thing, frame, kind, mask=region.mask, confidence=region.confidence)]


def _of_points(placed: Placed, thing: int, frame: int, kind: Kind) -> list[Shape]:
    if np.isnan(placed.xy[:, frame]).all():
        return []
    xy, occluded = placed.xy[:, frame], placed.occluded[:, frame]
    return [Shape(thing, frame, kind, xy=xy, occluded=occluded, confidence=float(placed.confidence[frame]))]


def _finding(region: Carried, frame: int, thing: int, kind: Kind, drawn: bool) -> Finding:
    confidence, sight = (1.0, 1.0) if drawn else (region.confidence, region.in_sight)
    gap = not drawn and not region.mask.any()
    return Finding(frame, thing, kind, drawn, confidence, gap, sight, region.disagreement, region.between)


def _finding_of_points(placed: Placed, frame: int, thing: int, kind: Kind, drawn: bool) -> Finding:
    apart = float(placed.disagreement[frame])
    pair = None if np.isnan(apart) else (int(placed.between[frame, 0]), int(placed.between[frame, 1]))
    gap = not drawn and not np.isfinite(placed.xy[:, frame]).all(axis=-1).any()
    confidence, sight = (1.0, 1.0) if drawn else (float(placed.confidence[frame]), float(placed.in_sight[frame]))
    return Finding(frame, thing, kind, drawn, confidence, gap, sight, None if pair is None else apart, pair)
