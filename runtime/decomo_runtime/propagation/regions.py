"""Regions carried from annotated frames to others.

Each pixel of a frame asks where its point was in every annotated frame, and takes the label that it had where it is
seen best. Where the point is in sight in none, it takes the label that was found in the frame beside, towards the
nearest annotated one. What is known of it else are its looks (`evidence.py`). The chances of a pixel's classes are a
product of three,

    votes * owner^OWNER * colours^COLOURS

each no surer than `SUREST`, and the rim is brought to the edges of the picture (`rim.py`).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.layers import look, raster_size
from decomo_runtime.propagation.evidence import Looks
from decomo_runtime.propagation.rim import Guide
from decomo_runtime.propagation.words import Word, words

if TYPE_CHECKING:
    from decomo_runtime.model import Appearance
    from decomo_runtime.objects import FramesByNumber
    from decomo_runtime.tracker import Tracker

Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

SIDE = 288
"""Most pixels of the longer side of the raster on which points are asked for."""
OWNER, COLOURS = 0.7, 0.6
"""Weights of what the looks say."""
SUREST = 0.95
"""Chance that a single one of the three may give."""
SPECK = 1 / 200
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
        self._drawn = {
            frame: {number: self._shrunk(mask) for number, mask in drawn[frame].items()} for frame in self._annotated
        }
        self._whole = tracker.height, tracker.width
        self._last: list[Carried] = []
        """[K], in the frame that was carried to last."""
        self._looks = Looks(self._count + 1)
        for frame, masks in self._drawn.items():
            seen = look(tracker, frame, self._size)
            confidence, picture = self._raster(seen.static_confidence), self._picture(frame, seen)
            shares = {number + 1: share for number, share in masks.items()}
            shares[0] = (1 - sum(masks.values(), np.zeros(self._size, np.float32))).clip(0, 1)
            for number, share in shares.items():
                self._looks.add(number, share, confidence, picture)

    def carry(self) -> Iterator[list[Carried]]:
        """Yields of each frame of the clip all objects [K]; where two claim a pixel, it is that of the likelier.

        Those nearer to the annotated frame ahead than to the one behind are found from there backwards, and kept.
        """
        kept: dict[int, list[tuple[Carried, bytes]]] = {}
        for frame in range(self._tracker.num_frames):
            nearest = min(self._annotated, key=lambda annotated: abs(annotated - frame))
            if nearest <= frame:
                yield self._carry(frame, frame - 1)
                continue
            for back in range(nearest - 1, frame - 1, -1) if frame not in kept else ():
                kept[back] = [_packed(each) for each in self._carry(back, back + 1)]
            yield [_unpacked(*each, self._whole) for each in kept.pop(frame)]

    def _carry(self, frame: int, beside: int) -> list[Carried]:
        """[K], in a frame, after the one `beside` it, unless one of the two is annotated."""
        seen = look(self._tracker, frame, self._size)
        picture = self._picture(frame, seen)
        steps = frame not in self._drawn and beside not in self._drawn
        found = {number: self._shrunk(each.mask) for number, each in enumerate(self._last)}
        said = words(self._tracker, frame, self._size, self._drawn | ({beside: found} if steps else {}))
        step = said.pop(beside) if steps else None
        chances = np.log(_at_most_sure(self._votes(list(said.values()), step)))
        chances += OWNER * np.log(_at_most_sure(self._looks.by_owner(self._raster(seen.static_confidence))))
        chances += COLOURS * np.log(_at_most_sure(self._looks.by_colour(picture)))
        chances = np.exp(chances - chances.max(axis=0))
        chances /= chances.sum(axis=0)
        labels, likely = self._at_full_size(frame, chances, picture)
        known = self._enlarged(np.max([word.sight for word in said.values()], axis=0))
        self._last = [self._carried(number, labels, likely, known, said) for number in range(self._count)]
        return self._last

    def _votes(self, said: Sequence[Word], beside: Word | None) -> Floats:
        """[class, h, w], chances by the annotated frames; where none has the point in sight by the frame beside, as far
        as that is sure of itself; even where that has not either.
        """
        even = np.float32(1 / (self._count + 1))
        votes = np.empty((self._count + 1, *self._size), np.float32)
        for number in range(self._count):
            chance = np.full(self._size, even)
            if beside is not None:
                chance += self._last[number].confidence * beside.sight * (beside.shares[number] - chance)
            speaking = [word for word in said if number in word.shares]
            if speaking:
                best = np.argmax([word.seen for word in speaking], axis=0)[None]
                sight, share = (
                    np.take_along_axis(np.stack(values), best, axis=0)[0]
                    for values in ([word.sight for word in speaking], [word.shares[number] for word in speaking])
                )
                chance += sight * (share - chance)
            votes[number + 1] = chance
        votes[0] = (1 - votes[1:].sum(axis=0)).clip(0, 1)
        return votes / votes.sum(axis=0)

    def _at_full_size(self, frame: int, chances: Floats, picture: Floats) -> tuple[npt.NDArray[np.int32], Floats]:
        """[H, W], the likeliest class and its chance."""
        full = None if self._frames is None else self._frames[frame].astype(np.float32) / np.float32(255)
        filtered = Guide(picture, picture if full is None else full)
        labels = np.zeros(self._whole, np.int32)
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
        said: Mapping[int, Word],
    ) -> Carried:
        mask = without_specks(labels == number + 1)
        most: tuple[float, tuple[int, int] | None] = (-1.0, None)
        speaking = [annotated for annotated, word in said.items() if number in word.shares]
        for pair in combinations(speaking, 2):
            both = (said[pair[0]].sight > 0) & (said[pair[1]].sight > 0)
            first, second = (said[annotated].shares[number][both] > 0.5 for annotated in pair)
            either = (first | second).sum()
            if either >= LEAST_COMMON:
                most = max(most, (float(1 - (first & second).sum() / either), pair), key=lambda each: each[0])
        confidence, share = (float(likely[mask].mean()), float(known[mask].mean())) if mask.any() else (0.0, 0.0)
        return Carried(mask, confidence, share, None if most[1] is None else most[0], most[1])

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
        return cv2.resize(image, self._whole[::-1], interpolation=cv2.INTER_LINEAR).astype(np.float32, copy=False)


def without_specks(mask: Mask) -> Mask:
    """[H, W], the mask without what is tiny beside its largest part."""
    count, parts, about, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    areas = about[1:, cv2.CC_STAT_AREA]
    kept = np.zeros(count, bool)
    kept[1:] = areas >= SPECK * areas.max(initial=0)
    return kept[parts.astype(np.int64)]


def _at_most_sure(chances: Floats) -> Floats:
    return chances.clip(1 - SUREST, SUREST)


def _packed(carried: Carried) -> tuple[Carried, bytes]:
    """Without its mask, and the mask in little room."""
    return replace(carried, mask=carried.mask[:0]), zlib.compress(np.packbits(carried.mask).tobytes())


def _unpacked(carried: Carried, mask: bytes, size: tuple[int, int]) -> Carried:
    bits = np.frombuffer(zlib.decompress(mask), np.uint8)
    return replace(carried, mask=np.unpackbits(bits, count=size[0] * size[1]).reshape(size).astype(bool))
