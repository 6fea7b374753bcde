"""The frames of a clip that one frame looks at for what it hides, and how they are held while that is made.

All around it are looked at small; whole, in the clip's own pixels, those next to it and one in some farther away.
A video is decoded fastest in order: small ones are read in blocks, ahead of the frame that is made, and the whole ones
of far frames are held on that way. Those next to it are read by a second reader, which follows at its own place.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import OverlayError, RuntimeInputError
from decomotion.frames import Frames

if TYPE_CHECKING:
    from decomo_runtime.model_file import ModelFacts

Image = npt.NDArray[np.uint8]

NEAR, STRIDE, FAR = 16, 4, 96
"""Frames up to this distance are all looked at whole; farther ones, up to the last distance, those whose number is a
multiple of the stride, and the clip's last: neighbours show nearly the same, and frames made one after another look at
the same.
"""
BESIDE = 15
"""Frames up to so far from each of those are looked at small."""
BLOCK = 16
"""Frames that are read one after another."""
HELD = 256
"""Small frames that are held, and what is made of them: more than a frame looks at, so that each is made once."""
HELD_BYTES = 512 * 1024**2
"""Of whole frames that are held; no more than `HELD` of them."""


class FramesByNumber(Protocol):
    """A clip's frames by number, each uint8 [H, W, 3] RGB: an array, or decoded when asked for."""

    def __len__(self) -> int: ...

    def __getitem__(self, frame: int, /) -> Image: ...


def check_footage(frames: FramesByNumber, model: ModelFacts, error: type[RuntimeInputError] = OverlayError) -> None:
    """Raises `error` where `frames` are not uint8 [T, H, W, 3] of the clip that the model was fitted to.

    Frames without a `shape` that are not in a list are known by their number alone: none is read.
    """
    wanted, known = (model.num_frames, model.height, model.width, 3), getattr(frames, "shape", None)
    kind = getattr(frames, "dtype", np.dtype(np.uint8))
    if known is not None:
        shape = tuple(known)
    elif isinstance(frames, list | tuple) and len(frames):
        shape, kind = (len(frames), *np.shape(frames[0])), np.asarray(frames[0]).dtype
    else:
        shape = (len(frames), *wanted[1:])
    if shape != wanted or kind != np.uint8:
        raise error(
            f"the model was fitted to the {model.num_frames} frames of {model.width}x{model.height} of "
            f"{model.clip_name}, uint8 {list(wanted)}, but the frames given are {kind} {list(shape)}; give that clip's"
        )


def others_of(frame: int, num_frames: int) -> list[int]:
    """The frames that are looked at for what `frame` hides, nearest in time first."""
    others = range(max(0, frame - FAR), min(num_frames, frame + FAR + 1))
    near = {other for other in others if abs(other - frame) <= NEAR}
    far = {other for other in others if other % STRIDE == 0 or other == num_frames - 1}
    return sorted((near | far) - {frame}, key=lambda other: abs(other - frame))


class Footage:
    """Frames by number, whole and small. No more are held than one frame looks at, however long the clip is.

    Args:
        frames: the clip.
        size: (height, width) of its frames.
        small: (height, width) of the small ones.
    """

    def __init__(self, frames: FramesByNumber, size: tuple[int, int], small: tuple[int, int]) -> None:
        self._ahead, self._beside = (frames.again() if isinstance(frames, Frames) else frames for _ in range(2))
        self._size = small
        self._most = max(2, min(HELD, HELD_BYTES // (3 * size[0] * size[1])))
        self._room_for_all = self._most >= min(len(frames), 2 * (FAR + BESIDE + BLOCK))
        self._small: OrderedDict[int, Image] = OrderedDict()
        self._whole: OrderedDict[int, Image] = OrderedDict()

    def __len__(self) -> int:
        return len(self._ahead)

    def __getitem__(self, frame: int, /) -> Image:
        if frame not in self._whole and frame not in self._small:
            self._read_around(frame)
        whole = self._whole.get(frame)
        return _held(self._whole, frame, self._beside[frame] if whole is None else whole, self._most)

    def leave_behind(self, frame: int) -> None:
        """Holds no frames longer that lie before `frame` and that it does not look at."""
        kept = {frame, *others_of(frame, len(self))}
        for number in [each for each in self._whole if each < frame and each not in kept]:
            del self._whole[number]
        for number in [each for each in self._small if each < frame - FAR - BESIDE]:
            del self._small[number]

    def small(self, frame: int) -> Image:
        """A frame at the small size; a pixel is the mean of those that it covers."""
        small = self._small.get(frame)
        return _held(self._small, frame, self._read_around(frame) if small is None else small, HELD)

    def _read_around(self, frame: int) -> Image:
        """Reads the block that a frame lies in; the frame, small."""
        first, read = frame - frame % BLOCK, dict[int, Image]()
        for number in range(first, min(len(self), first + BLOCK)):
            if number in self._small:
                continue
            whole = self._whole.get(number)
            whole = self._ahead[number] if whole is None else whole
            small = cv2.resize(whole, self._size[::-1], interpolation=cv2.INTER_AREA)
            read[number] = _held(self._small, number, small.astype(np.uint8, copy=False), HELD)
            if self._room_for_all or number % STRIDE == 0:
                _held(self._whole, number, whole, self._most)
        return read[frame]


def _held(images: OrderedDict[int, Image], number: int, image: Image, most: int) -> Image:
    """The image, held as the one asked for last, of which there are so many at `most`."""
    images[number] = image
    images.move_to_end(number)
    while len(images) > most:
        images.popitem(last=False)
    return image
