"""Draws tracks on the frames of their clip.

Each point keeps one colour, taken from a rainbow by where it was queried. A disc marks it where it is seen, a ring or
a cross where the model holds it to be occluded; a fading trail shows where it has been, fainter while occluded. Where
the scene's motion is given, the trail is relative to the static scene: a point that does not move by itself has none.

Unless a canvas is given, small clips are enlarged by a whole factor first; a place x of the clip lies at
(x + 0.5) * scale - 0.5 on the canvas. All that is drawn goes on one layer of premultiplied RGBA, laid over the muted
frame once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import OverlayError
from decomo_runtime.model_file import ModelFacts
from decomo_runtime.options import MARKS
from decomo_runtime.pictures import evened
from decomo_runtime.tracks import Tracks
from decomotion.clip import Clip
from decomotion.frames import AnyFrames

if TYPE_CHECKING:
    from decomo_runtime.scene_motion import SceneMotion

Image = npt.NDArray[np.uint8]

LONG_SIDE = 512
"""Clips whose longer side has fewer pixels than this are enlarged."""
TRAIL = 12
"""Length of the trail in frames."""

_COLOUR_KEPT, _LIGHT_KEPT = 0.55, 0.8
"""How far the frame is muted, so that the inks stand out."""
_OCCLUDED_INK, _RIM_INK = 0.3, 0.55
_LAST_HUE = 150
"""Magenta, of OpenCV's 180 hues; the rest of the wheel would lead back to red."""
_SHIFT = 4
"""OpenCV draws at 1 / 2**_SHIFT of a pixel."""
_FAR = 8192
"""Canvas pixels beyond which nothing is drawn: OpenCV's fixed-point numbers would overflow."""


@dataclass(frozen=True)
class _Pen:
    """Sizes in canvas pixels."""

    radius: float
    thickness: int


def check_clip(clip: Clip, model: ModelFacts) -> None:
    """`OverlayError` where `clip` has not the size or the length of the clip that the model was fitted to."""
    if (clip.width, clip.height, len(clip)) != (model.width, model.height, model.num_frames):
        raise OverlayError(
            f"the clip {clip.name} has {len(clip)} frames of {clip.width}x{clip.height} but the model was fitted to "
            f"{model.clip_name} with {model.num_frames} frames of {model.width}x{model.height}; give that clip"
        )


def draw_tracks(
    frames: AnyFrames,
    tracks: Tracks,
    *,
    trail: int = TRAIL,
    mark: str = MARKS[0],
    motion: SceneMotion | None = None,
) -> Iterator[Image]:
    """Yields, for each of `tracks.frames`, that frame of the clip with the tracks on it, RGB and of even size.

    `frames` uint8 [T, H, W, 3] are those of the whole clip, read one at a time; the rest is as for `Painter`.
    """
    painter = Painter(tracks, frames.shape[1:3], trail=trail, mark=mark, motion=motion)
    for column, frame in enumerate(tracks.frames):
        yield painter.draw(frames[frame], column)


class Painter:
    """Draws one frame's points and trails on a picture.

    Args:
        tracks: in pixels of the clip.
        size: (height, width) of the clip.
        canvas: (height, width) of what is drawn on; default: that of the clip, enlarged to `LONG_SIDE` or beyond.
        trail: length in frames.
        mark: of an occluded point, one of `MARKS`.
        motion: of the static scene; the trails are then drawn relative to it.
    """

    def __init__(
        self,
        tracks: Tracks,
        size: Sequence[int],
        *,
        canvas: Sequence[int] | None = None,
        trail: int = TRAIL,
        mark: str = MARKS[0],
        motion: SceneMotion | None = None,
    ) -> None:
        self._tracks, self._trail, self._mark, self._motion = tracks, trail, mark, motion
        factor = max(1, -(-LONG_SIDE // max(size)))
        height, width = (side * factor for side in size) if canvas is None else canvas
        self._canvas = width, height
        self._scale = width / size[1], height / size[0]
        self._inks = rainbow(tracks.queries)

    def draw(self, picture: Image, column: int) -> Image:
        """The picture, RGB of any size that covers the clip's frame, with the tracks at their frame `column` on it."""
        if picture.shape[1::-1] != self._canvas:
            picture = cv2.resize(picture, self._canvas, interpolation=cv2.INTER_CUBIC).astype(np.uint8, copy=False)
        canvas = _muted(evened(picture))
        pen = _pen_for(len(self._inks), canvas)
        layer = np.zeros((*canvas.shape[:2], 4), np.uint8)
        past = slice(max(0, column - self._trail), column + 1)
        places, occluded = self._places(range(len(self._tracks.frames))[past], column), self._tracks.occluded[:, past]
        _draw_trails(layer, places, occluded, self._inks, pen, self._trail)
        _draw_marks(layer, places[:, -1], occluded[:, -1], self._inks, pen, self._mark)
        return _laid_over(canvas, layer)

    def _places(self, past: Sequence[int], column: int) -> npt.NDArray[np.float64]:
        """[N, L, 2], canvas pixels at `column`; nan where nothing can be drawn."""
        frames = self._tracks.frames
        xy = self._tracks.xy[:, list(past)].astype(np.float64)
        if self._motion is not None:
            xy = [self._motion.carry(xy[:, i], int(frames[j]), int(frames[column])) for i, j in enumerate(past)]
            xy = np.stack(xy, axis=1)
        places = (xy + 0.5) * self._scale - 0.5
        places[~(np.abs(places) < _FAR).all(-1)] = np.nan
        return places


def rainbow(queries: npt.NDArray[np.float32]) -> Image:
    """RGB [N, 3], from red to magenta: the colour of each query (t, x, y) by its place in the box that holds them all.

    The hue runs from the upper left to the lower right, a little faster sideways, so that rows and columns differ.
    """
    if len(queries) == 0:
        return np.empty((0, 3), np.uint8)
    place = queries[:, 1:].astype(np.float64)
    extent = np.ptp(place, axis=0)
    along = ((place - place.min(0)) / np.where(extent > 0, extent, 1)) @ (0.6, 0.4)
    hue = _LAST_HUE * along
    wheel = np.stack([hue, np.full_like(hue, 0.75 * 255), np.full_like(hue, 255)], axis=1)
    return cv2.cvtColor(np.rint(wheel).astype(np.uint8)[None], cv2.COLOR_HSV2RGB)[0].astype(np.uint8, copy=False)


def contact_sheet(frames: Sequence[Image], *, gap: int = 8) -> Image:
    """The frames (at least one, RGB, of one height) side by side, `gap` white pixels apart."""
    white = np.full((frames[0].shape[0], gap, 3), 255, np.uint8)
    strips = [strip for frame in frames for strip in (white, frame)]
    return np.concatenate(strips[1:], axis=1)


def _muted(frame: Image) -> Image:
    grey = cv2.cvtColor(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    muted = cv2.addWeighted(frame, _LIGHT_KEPT * _COLOUR_KEPT, grey, _LIGHT_KEPT * (1 - _COLOUR_KEPT), 0)
    return muted.astype(np.uint8, copy=False)


def _pen_for(points: int, canvas: Image) -> _Pen:
    """Discs of a sixth of the points' mean spacing, within what stays legible at the canvas's size."""
    height, width = canvas.shape[:2]
    spacing = (height * width / max(points, 1)) ** 0.5
    largest = 0.009 * max(height, width)
    radius = float(np.clip(spacing / 6, 0.3 * largest, largest))
    return _Pen(radius, max(1, round(0.55 * radius)))


def _draw_trails(
    layer: Image,
    places: npt.NDArray[np.float64],
    occluded: npt.NDArray[np.bool_],
    inks: Image,
    pen: _Pen,
    trail: int,
) -> None:
    """Lines through `places` [N, L, 2], oldest first, so that the newest lies on top."""
    length = places.shape[1]
    for step in range(length - 1):
        fade = 1 - (length - 2 - step) / trail
        ends = places[:, step : step + 2]
        hidden = occluded[:, step] | occluded[:, step + 1]
        for point in np.flatnonzero(np.isfinite(ends).all(axis=(1, 2))):
            ink = _ink(inks[point], fade * (_OCCLUDED_INK if hidden[point] else 0.9))
            cv2.line(layer, _fixed(ends[point, 0]), _fixed(ends[point, 1]), ink, pen.thickness, cv2.LINE_AA, _SHIFT)


def _draw_marks(
    layer: Image, places: npt.NDArray[np.float64], occluded: npt.NDArray[np.bool_], inks: Image, pen: _Pen, mark: str
) -> None:
    """`mark` at each occluded point of `places` [N, 2], then a dark-rimmed disc at each one in sight."""
    present = np.isfinite(places).all(1)
    rim = _ink(np.zeros(3, np.uint8), _RIM_INK)
    for point in np.flatnonzero(present & occluded):
        ink = _ink(inks[point], 0.85)
        if mark == "ring":
            cv2.circle(layer, _fixed(places[point]), _fixed_length(pen.radius), ink, 1, cv2.LINE_AA, _SHIFT)
        elif mark == "cross":
            for arm in (np.array([1, 1]), np.array([1, -1])):
                begin, end = (_fixed(places[point] + side * pen.radius * arm) for side in (-1, 1))
                cv2.line(layer, begin, end, ink, 1, cv2.LINE_AA, _SHIFT)
    for point in np.flatnonzero(present & ~occluded):
        centre = _fixed(places[point])
        cv2.circle(layer, centre, _fixed_length(pen.radius + 1), rim, cv2.FILLED, cv2.LINE_AA, _SHIFT)
        cv2.circle(layer, centre, _fixed_length(pen.radius), _ink(inks[point], 1), cv2.FILLED, cv2.LINE_AA, _SHIFT)


def _ink(colour: Image, opacity: float) -> tuple[float, float, float, float]:
    """Premultiplied RGBA."""
    red, green, blue = (opacity * float(channel) for channel in colour)
    return red, green, blue, 255 * opacity


def _fixed(place: npt.NDArray[np.float64]) -> tuple[int, int]:
    return _fixed_length(place[0]), _fixed_length(place[1])


def _fixed_length(length: float) -> int:
    return round(length * (1 << _SHIFT))


def _laid_over(canvas: Image, layer: Image) -> Image:
    clear = 1 - layer[..., 3:].astype(np.float32) / 255
    return np.rint(canvas * clear + layer[..., :3]).clip(0, 255).astype(np.uint8)
