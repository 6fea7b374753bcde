"""Deformations in closed form, photographed off a random texture: what strain is measured against.

X is a place in frame 0, in pixels from the frame's middle; `amount` grows from 0 in frame 0 to 1 in the last one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

Places = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

WAVE = 96.0
"""Pixels, of the bending wave's length."""
_OVERSAMPLED = 2
_NOISE = 1.0
"""Deviation of a camera's noise, of 255."""


@dataclass(frozen=True)
class Deformation:
    """One kind."""

    name: str
    there: Callable[[Places, float], Places]
    """Places [..., 2] of X [..., 2] at an amount."""
    back: Callable[[Places, float], Places]
    """Its inverse."""
    gradient: Callable[[Places, float], Places]
    """F [..., 2, 2] at X."""


def _affine(name: str, matrix: Callable[[float], Places]) -> Deformation:
    return Deformation(
        name,
        lambda places, amount: places @ matrix(amount).T,
        lambda places, amount: places @ np.linalg.inv(matrix(amount)).T,
        lambda places, amount: np.broadcast_to(matrix(amount), (*places.shape, 2)),
    )


def _turned(amount: float) -> Places:
    angle = np.radians(20) * amount
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _wave(places: Places, amount: float) -> Places:
    """[..., 2]: how far the wave moves X down; it depends on x alone."""
    height = 0.2 * WAVE / (2 * np.pi) * amount * np.sin(2 * np.pi / WAVE * places[..., 0])
    return np.stack([np.zeros_like(height), height], axis=-1)


def _wave_gradient(places: Places, amount: float) -> Places:
    gradient = np.broadcast_to(np.eye(2), (*places.shape, 2)).copy()
    gradient[..., 1, 0] = 0.2 * amount * np.cos(2 * np.pi / WAVE * places[..., 0])
    return gradient


DEFORMATIONS = (
    _affine("stretch", lambda amount: np.diag([1 + 0.15 * amount, 1 - 0.05 * amount])),
    _affine("shear", lambda amount: np.array([[1, 0.2 * amount], [0, 1]])),
    _affine("rotation", _turned),
    Deformation(
        "wave",
        lambda places, amount: places + _wave(places, amount),
        lambda places, amount: places - _wave(places, amount),
        _wave_gradient,
    ),
)


@dataclass(frozen=True)
class Deformed:
    """A clip of one deformation."""

    deformation: Deformation
    num_frames: int
    height: int
    width: int
    seed: int = 0

    def amount(self, frame: int) -> float:
        """From 0 to 1."""
        return frame / (self.num_frames - 1)

    @property
    def middle(self) -> Places:
        """[2], of the frame, in pixels."""
        return np.array([self.width - 1, self.height - 1]) / 2

    def follow(self, places: Places, frame: int) -> Places:
        """[..., 2] in `frame`, pixels, of places in frame 0."""
        return self.deformation.there(places - self.middle, self.amount(frame)) + self.middle

    def gradient(self, places: Places, frame: int) -> Places:
        """F [..., 2, 2] from frame 0 to `frame`, at places in frame 0."""
        return self.deformation.gradient(places - self.middle, self.amount(frame))

    def frames(self) -> npt.NDArray[np.uint8]:
        """[T, H, W, 3], RGB."""
        rng = np.random.default_rng(self.seed)
        margin = max(self.height, self.width)
        sheet = _texture(rng, 3 * margin)
        y, x = np.mgrid[: self.height * _OVERSAMPLED, : self.width * _OVERSAMPLED]
        places = (np.stack([x, y], axis=-1) + 0.5) / _OVERSAMPLED - 0.5 - self.middle
        pictures = []
        for frame in range(self.num_frames):
            there = (self.deformation.back(places, self.amount(frame)) + 1.5 * margin).astype(np.float32)
            fine = cv2.remap(sheet, there[..., 0], there[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
            exact = cv2.resize(fine, (self.width, self.height), interpolation=cv2.INTER_AREA)
            noisy = exact + _NOISE * rng.standard_normal(exact.shape)
            pictures.append(np.rint(noisy).clip(0, 255).astype(np.uint8))
        return np.stack(pictures)


def _texture(rng: np.random.Generator, side: int) -> npt.NDArray[np.float32]:
    """[side, side, 3]: structures of three pixels and more, in colours."""
    noise = rng.standard_normal((side, side, 3)).astype(np.float32)
    layers = [cv2.GaussianBlur(noise, (0, 0), size) for size in (1.5, 3, 8)]
    return np.asarray(sum(25 * layer / layer.std() for layer in layers) + 128, np.float32)


def bins(edges: tuple[float, ...], values: npt.NDArray[np.floating]) -> dict[str, npt.NDArray[np.bool_]]:
    """By the names of the intervals between `edges`, which of `values` are in each."""
    return {f"{low:g}-{high:g}": (values >= low) & (values < high) for low, high in pairwise(edges)}
