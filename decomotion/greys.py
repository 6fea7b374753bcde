"""Frames in grey and small: enough to tell one shot from another."""

from __future__ import annotations

import weakref
from tempfile import TemporaryFile
from threading import Lock

import cv2
import numpy as np
import numpy.typing as npt

Grey = npt.NDArray[np.float32]
"""[h, w], 0 to 255."""

SIDE = 160
"""Pixels of the longer side at most."""
LEAST_SIDE = 24
"""Pixels of the shorter side at least: flow needs them."""


def size_of_grey(height: int, width: int) -> tuple[int, int]:
    """(height, width) of the small picture of a frame."""
    scale = min(1.0, SIDE / max(height, width))
    return max(LEAST_SIDE, round(height * scale)), max(LEAST_SIDE, round(width * scale))


def small_grey(image: npt.NDArray[np.uint8]) -> Grey:
    """A frame RGB [H, W, 3] or grey [H, W] in grey and small; pixels are averages."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return shrunk(np.asarray(grey, np.uint8), size_of_grey(*image.shape[:2]))


def shrunk(grey: npt.NDArray[np.uint8], size: tuple[int, int]) -> Grey:
    """A grey picture [H, W] brought to a (height, width)."""
    resized = cv2.resize(grey.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(resized, np.float32)


def stored(grey: Grey) -> Grey:
    """As `GreyFile` gives it back."""
    return grey.astype(np.float16).astype(np.float32)


class GreyFile:
    """Small pictures of one size in a temporary file, which goes with the object: those of hours take no memory.

    Raises `OSError` where there is no room for one.
    """

    def __init__(self) -> None:
        self._file = TemporaryFile(prefix="decomo-", buffering=0)  # noqa: SIM115 - closed by the finalizer
        self._shape: tuple[int, ...] = ()
        self._lock = Lock()
        weakref.finalize(self, self._file.close)

    def add(self, grey: Grey) -> None:
        """Puts one behind the others, as float16."""
        self._shape = grey.shape
        self._file.write(grey.astype(np.float16).tobytes())

    def __getitem__(self, number: int) -> Grey:
        size = 2 * int(np.prod(self._shape))
        with self._lock:
            self._file.seek(number * size)
            content = self._file.read(size)
        return np.frombuffer(content, np.float16).reshape(self._shape).astype(np.float32)
