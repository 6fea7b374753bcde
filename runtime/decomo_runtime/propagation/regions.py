"""Regions carried from annotated frames to others.

Each pixel of a frame asks where its point was in every annotated frame, and takes the label that it had in the one in
which it is seen best. Where the point is in sight in none, nothing is known of it but its looks (`evidence.py`). The
chances of a pixel's classes are a product of three,

    votes * owner^OWNER * colours^COLOURS

each no surer than `SUREST`, and the rim is brought to the edges of the picture (`rim.py`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.layers import look, pixel_queries, raster_size
from decomo_runtime.propagation import disagreement
from decomo_runtime.propagation.evidence import Looks
from decomo_runtime.propagation.rim import Guide
from decomotion.units import unit

if TYPE_CHECKING:
    from decomo_runtime.footage import FramesByNumber
    from decomo_runtime.model import Appearance
    from decomo_runtime.tracker import Tracker

Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

SIDE = 288
"""Most pixels of the longer side of the raster on which points are asked for."""
OWNER, COLOURS = 0.7, 0.6
"""Weights of what the looks say."""
SUREST = 0.95
"""Chance that a single one of the three may give."""
FALL = 2.0
"""Power by which a point is seen worse in an annotated frame as the expected error grows, in units."""
SPECK = 1 / 100
"""Parts of a mask that are smaller than this share of its largest are left out."""
LEAST_COMMON = 16
"""Pixels of the raster that two annotated frames must both have on an object to be compared."""


@dataclass(frozen=True, eq=False)
class Carried:
    """One object in one frame."""

    mask: Mask
    """[H, W]."""
    confidence: float
    """Mean chance of the mask's pixels to be the object's; 0 where it has none."""
    in_sight: float
    """Share of its pixels whose points are in sight in an annotated frame; 0 where it has none."""
    disagreement: float | None
    """1 - IoU of what two annotated frames say of pixels that both have in sight, the most of all pairs; None where no
    two have enough."""
    between: tuple[int, int] | None
    """The two frames."""


class Regions:
    """Carries regions of objects 0 .. K - 1.

    Args:
        tracker: the model.
        drawn: of each annotated frame the objects drawn in it, bool [H, W] by their numbers. A frame says nothing of
            others.
        frames: the clip's own frames; without them the model's rendering takes their place.
    """

    def __init__(
        self, tracker: Tracker, drawn: Mapping[int, Mapping[int, Mask]], frames: FramesByNumber | None = None
    ) -> None:
        self._tracker, self._frames = tracker, frames
        self._size = raster_size(tracker.facts, min(SIDE, max(tracker.height, tracker.width)))
        self._annotated = sorted(drawn)
        self._count = 1 + max(max(each, default=-1) for each in drawn.values())
        small = {frame: {number: self._shrunk(mask) for number, mask in drawn[frame].items()} for frame in drawn}
        self._drawn = small
        self._looks = Looks(self._count + 1)
        for frame, masks in small.items():
            seen = look(tracker, frame, self._size)
            confidence, picture = self._raster(seen.static_confidence), self._picture(frame, seen)
            shares = {number + 1: share for number, share in masks.items()}
            shares[0] = (1 - sum(masks.values(), np.zeros(self._size, np.float32))).clip(0, 1)
            for number, share in shares.items():
                self._looks.add(number, share, confidence, picture)

    def carry(self, frame: int) -> list[Carried]:
        """[K], all objects in a frame; where two claim a pixel, it is that of the likelier."""
        seen = look(self._tracker, frame, self._size)
        picture = self._picture(frame, seen)
        said, sight, sure = self._said(frame)
        chances = np.log(_at_most_sure(self._votes(said, sight, sure)))
        chances += OWNER * np.log(_at_most_sure(self._looks.by_owner(self._raster(seen.static_confidence))))
        chances += COLOURS * np.log(_at_most_sure(self._looks.by_colour(picture)))
        chances = np.exp(chances - chances.max(axis=0))
        chances /= chances.sum(axis=0)
        labels, likely = self._at_full_size(frame, chances, picture)
        known = self._enlarged(sight.max(axis=0))
        return [self._carried(number, labels, likely, known, said, sight > 0) for number in range(self._count)]

    def _said(self, frame: int) -> tuple[list[dict[int, Floats]], Floats, Floats]:
        """Of each annotated frame the shares of its objects at the pixels of `frame`, and [annotated, h, w] how much
        in sight the points are there, from 0 to 1, and how sure their places.
        """
        facts, size = self._tracker.facts, self._size
        tracks = self._tracker.track(pixel_queries(frame, size, facts), self._annotated)
        said: list[dict[int, Floats]] = []
        sight, sure = np.empty((2, len(self._annotated), *size), np.float32)
        whole = unit(facts.height, facts.width)
        scale = np.array([size[1] / facts.width, size[0] / facts.height], np.float32)
        for column, annotated in enumerate(self._annotated):
            there = tracks.xy[:, column]
            inside = ((there >= -0.5) & (there <= np.array([facts.width, facts.height]) - 0.5)).all(axis=1)
            x, y = np.moveaxis(((there + 0.5) * scale - 0.5).reshape(*size, 2).astype(np.float32), -1, 0)
            masks = self._drawn[annotated]
            said.append({number: _at(share, x, y) for number, share in masks.items()})
            shown = (1 - tracks.occlusion[:, column] / facts.occlusion_threshold).clip(0, 1) * inside
            error = np.zeros(len(shown)) if tracks.error is None else tracks.error[:, column] / whole
            sight[column], sure[column] = shown.reshape(size), ((1 + error) ** -FALL).reshape(size)
        return said, sight, sure

    def _votes(self, said: Sequence[Mapping[int, Floats]], sight: Floats, sure: Floats) -> Floats:
        """[class, h, w], chances by the annotated frames alone; even where none has the point in sight."""
        even = 1 / (self._count + 1)
        votes = np.full((self._count + 1, *self._size), even, np.float32)
        for number in range(self._count):
            speaking = [column for column, masks in enumerate(said) if number in masks]
            if speaking:
                best = (sight[speaking] * sure[speaking]).argmax(axis=0)[None]
                shares = np.stack([said[column][number] for column in speaking])
                share, trust = (np.take_along_axis(values, best, axis=0)[0] for values in (shares, sight[speaking]))
                votes[number + 1] += trust * (share - even)
        votes[0] = (1 - votes[1:].sum(axis=0)).clip(0, 1)
        return votes / votes.sum(axis=0)

    def _at_full_size(self, frame: int, chances: Floats, picture: Floats) -> tuple[npt.NDArray[np.int32], Floats]:
        """[H, W], the likeliest class and its chance."""
        full = None if self._frames is None else self._frames[frame].astype(np.float32) / np.float32(255)
        filtered = Guide(picture, picture if full is None else full)
        labels = np.zeros((self._tracker.height, self._tracker.width), np.int32)
        best = np.zeros(labels.shape, np.float32)
        for number, chance in enumerate(chances):
            at_size = filtered(chance)
            at_size = self._enlarged(at_size) if full is None else at_size
            labels[at_size > best] = number
            np.maximum(best, at_size, out=best)
        return labels, best

    def _carried(
        self,
        number: int,
        labels: npt.NDArray[np.int32],
        likely: Floats,
        known: Floats,
        said: Sequence[Mapping[int, Floats]],
        in_sight: Mask,
    ) -> Carried:
        mask = without_specks(labels == number + 1)
        speaking = [column for column, masks in enumerate(said) if number in masks]
        apart = pair = None
        if len(speaking) > 1:
            of_each = np.stack([said[column][number] > 0.5 for column in speaking]).reshape(len(speaking), -1)
            seen = in_sight[speaking].reshape(len(speaking), -1)
            if (most := disagreement.of_regions(of_each, seen, LEAST_COMMON)) is not None:
                apart, (one, other) = most
                pair = self._annotated[speaking[one]], self._annotated[speaking[other]]
        confidence, share = (float(likely[mask].mean()), float(known[mask].mean())) if mask.any() else (0.0, 0.0)
        return Carried(mask, confidence, share, apart, pair)

    def _picture(self, frame: int, seen: Appearance) -> Floats:
        """[h, w, 3], RGB in [0, 1]: the clip's, or what the model renders."""
        if self._frames is None:
            return seen.rgb.reshape(*self._size, 3).clip(0, 1).astype(np.float32)
        return self._shrunk(self._frames[frame]) / np.float32(255)

    def _raster(self, values: Floats) -> Floats:
        return values.reshape(self._size)

    def _shrunk(self, image: npt.NDArray[np.generic]) -> Floats:
        shrunk = cv2.resize(image.astype(np.float32), self._size[::-1], interpolation=cv2.INTER_AREA)
        return shrunk.astype(np.float32, copy=False)

    def _enlarged(self, image: Floats) -> Floats:
        size = self._tracker.width, self._tracker.height
        return cv2.resize(image, size, interpolation=cv2.INTER_LINEAR).astype(np.float32, copy=False)


def without_specks(mask: Mask) -> Mask:
    """[H, W], the mask without what is tiny beside its largest part."""
    count, parts, about, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    areas = about[1:, cv2.CC_STAT_AREA]
    kept = np.zeros(count, bool)
    kept[1:] = areas >= SPECK * areas.max(initial=0)
    return kept[parts.astype(np.int64)]


def _at_most_sure(chances: Floats) -> Floats:
    return chances.clip(1 - SUREST, SUREST)


def _at(image: Floats, x: Floats, y: Floats) -> Floats:
    """Bilinear; the nearest pixel's beyond the borders."""
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32, copy=False)
