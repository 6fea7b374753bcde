"""Measured values as colours on the clip in grey, with a bar for the colours and one for lengths below the picture.

Values of both signs run from blue through white to red, the others along viridis. What is hidden has no colour: hidden
points are rings, hidden parts of a map show the clip.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.measure.units import Scale
from decomo_runtime.overlay import LONG_SIDE
from decomo_runtime.pictures import evened

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.floating]
Mask = npt.NDArray[np.bool_]

FOOTER = 56
"""Pixels, below the picture."""
SHARE = 98
"""Percent of the values that the colours tell apart where no limit is given."""
OPACITY = 0.7
_SHIFT = 4
_FAR = 8192
_COLD_TO_WARM = np.array([(33, 102, 172), (146, 197, 222), (247, 247, 247), (244, 165, 130), (178, 24, 43)], np.float64)
"""RGB, from the lowest value to the highest, equally far apart."""
_LENGTH_SHARE = 0.2
"""Of the picture's width that the bar of lengths may have."""


def limit_of(values: Floats, hidden: Mask) -> float:
    """Which value has the last colour: `SHARE` percent of those in sight are within it; two digits, above 0."""
    known = np.abs(values[np.isfinite(values) & ~hidden])
    limit = float(np.percentile(known, SHARE)) if known.size else 0.0
    return float(f"{limit:.2g}") if limit > 0 else 1.0


@dataclass(frozen=True)
class Colours:
    """Of one quantity."""

    name: str
    unit: str
    limit: float
    signed: bool

    def of(self, values: Floats) -> Image:
        """RGB [..., 3] of finite values [...]."""
        low = -self.limit if self.signed else 0.0
        share = np.clip((values - low) / (self.limit - low), 0, 1)
        return self._table[np.rint(share * 255).astype(int)]

    @cached_property
    def _table(self) -> Image:
        """[256, 3]"""
        ramp = np.arange(256, dtype=np.uint8)[None]
        if not self.signed:
            return np.asarray(
                cv2.cvtColor(cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS), cv2.COLOR_BGR2RGB)[0], np.uint8
            )
        stops = np.linspace(0, 255, len(_COLD_TO_WARM))
        channels = [np.interp(ramp[0], stops, each) for each in _COLD_TO_WARM.T]
        return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


class Chart:
    """Draws on frames of a clip.

    Args:
        colours: of what is shown.
        size: (height, width) of the clip.
        scale: of its pixels.
        pixel_aspect: width of a pixel over its height.
    """

    def __init__(self, colours: Colours, size: Sequence[int], scale: Scale, pixel_aspect: float) -> None:
        height, width = size
        self._colours, self._factor = colours, max(1, -(-LONG_SIDE // max(size)))
        self._canvas = width * self._factor, height * self._factor
        self._footer = self._drawn_footer(scale, pixel_aspect)

    def points(self, picture: Image, places: Floats, values: Floats, hidden: Mask, spacing: float) -> Image:
        """Discs at `places` [K, 2], in pixels of the clip, with values [K]; hidden ones are rings."""
        canvas = self._begun(picture)
        radius = max(3.0, min(spacing * self._factor * 0.45, 0.012 * max(self._canvas)))
        at = self._on_canvas(places)
        shown = np.isfinite(at).all(-1) & np.isfinite(values)
        inks = self._colours.of(values[shown]).tolist()
        for place, ink, dim in zip(at[shown], inks, hidden[shown], strict=True):
            centre, thickness = tuple(np.rint(place * 2**_SHIFT).astype(int).tolist()), 1 if dim else cv2.FILLED
            cv2.circle(canvas, centre, round(radius * 2**_SHIFT), ink, thickness, cv2.LINE_AA, _SHIFT)
        return self._finished(canvas)

    def cells(self, picture: Image, places: Floats, values: Floats, hidden: Mask, groups: Mask) -> Image:
        """The cells between nodes at `places` [h, w, 2] with values [h, w]; none at a hidden node, or across groups."""
        canvas = self._begun(picture)
        at = self._on_canvas(places)
        shown = np.isfinite(at).all(-1) & np.isfinite(values) & ~hidden
        four = [(slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None))]
        four += [(slice(1, None), slice(1, None)), (slice(1, None), slice(None, -1))]  # around a cell
        same = np.all([groups[corner] == groups[four[0]] for corner in four], axis=0)
        drawn = same & np.all([shown[corner] for corner in four], axis=0)
        corners = np.stack([at[corner][drawn] for corner in four], axis=1)
        inks = self._colours.of(np.mean([values[corner][drawn] for corner in four], axis=0)).tolist()
        layer = canvas.copy()
        for quad, ink in zip(np.rint(corners * 2**_SHIFT).astype(np.int32), inks, strict=True):
            cv2.fillConvexPoly(layer, quad, ink, cv2.LINE_8, _SHIFT)
        mixed = cv2.addWeighted(layer, OPACITY, canvas, 1 - OPACITY, 0)
        return self._finished(np.asarray(mixed, np.uint8))

    def _begun(self, picture: Image) -> Image:
        if picture.shape[1::-1] != self._canvas:
            picture = np.asarray(cv2.resize(picture, self._canvas, interpolation=cv2.INTER_CUBIC), np.uint8)
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), np.uint8)

    def _finished(self, canvas: Image) -> Image:
        return evened(np.concatenate([canvas, self._footer]))

    def _on_canvas(self, places: Floats) -> npt.NDArray[np.float64]:
        at = (np.asarray(places, np.float64) + 0.5) * self._factor - 0.5
        return np.where((np.abs(at) < _FAR).all(-1, keepdims=True), at, np.nan)

    def _drawn_footer(self, scale: Scale, pixel_aspect: float) -> Image:
        width = self._canvas[0]
        footer = np.full((FOOTER, width, 3), 24, np.uint8)
        pixel = scale.length * pixel_aspect / self._factor
        length = _round_length(_LENGTH_SHARE * width * pixel)
        end = 16 + round(length / pixel)
        cv2.line(footer, (16, 20), (end, 20), (255, 255, 255), 2)
        for x in (16, end):
            cv2.line(footer, (x, 15), (x, 25), (255, 255, 255), 2)
        _write(footer, f"{length:g} {scale.unit}", 16, 44)
        left, right = round(0.45 * width), width - 16
        low = -self._colours.limit if self._colours.signed else 0.0
        ramp = self._colours.of(np.linspace(low, self._colours.limit, right - left))
        footer[14:26, left:right] = ramp
        unit = "" if self._colours.unit == "1" else f" [{self._colours.unit}]"
        _write(footer, f"{low:g}", left, 44)
        last = f"{self._colours.limit:g}"
        _write(footer, last, right - _width(last), 44)
        name = f"{self._colours.name}{unit}"
        _write(footer, name, (left + right - _width(name)) // 2, 44)
        return footer


def _round_length(most: float) -> float:
    """1, 2 or 5 times a power of ten, no more than `most`, but for what rounding takes from it."""
    most *= 1 + 1e-9
    power = 10.0 ** math.floor(math.log10(most))
    return next(factor * power for factor in (5, 2, 1) if factor * power <= most)


def _width(text: str) -> int:
    return cv2.getTextSize(_ascii(text), cv2.FONT_HERSHEY_SIMPLEX, 0.42, 1)[0][0]


def _write(image: Image, text: str, x: int, y: int) -> None:
    cv2.putText(image, _ascii(text), (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)


def _ascii(text: str) -> str:
    """OpenCV's letters have no µ."""
    return text.replace("µ", "u")
