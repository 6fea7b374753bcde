"""Motion masks of the user: a folder of images, one a frame."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomotion.errors import SupervisionError
from decomotion.frame_files import decode_mask, images_in

log = logging.getLogger(__name__)

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class MaskFiles(Sequence[Mask]):
    """Masks [H, W], one a frame, each read when it is asked for."""

    files: tuple[Path, ...]
    sides: tuple[int, int]
    """Height and width."""
    digest: str
    """Hash of what they show."""

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, frame: int) -> Mask:  # type: ignore[override]
        """Raises `SupervisionError` where the file is none, or has another size."""
        return _read(self.files[frame], self.sides)


def read_masks(folder: Path, frames: int, height: int, width: int) -> MaskFiles:
    """The masks in a folder of images, one a frame in natural order; any pixel that is not black moves.

    All are looked at here, and none is kept. Raises `SupervisionError` where they do not fit the clip.
    """
    if not folder.is_dir():
        raise SupervisionError(
            f"mask folder {folder} does not exist; give a folder of images, 'auto', 'isnet' or 'none'"
        )
    files = images_in(folder)
    if len(files) != frames:
        raise SupervisionError(f"mask folder {folder} has {len(files)} images but the clip has {frames} frames")
    content, moves = hashlib.sha256(), False
    for file in files:
        mask = _read(file, (height, width))
        content.update(np.packbits(mask).tobytes())
        moves |= bool(mask.any())
    if not moves:
        log.warning("all masks in %s are black: nothing moves", folder)
    return MaskFiles(tuple(files), (height, width), content.hexdigest())


def _read(file: Path, sides: tuple[int, int]) -> Mask:
    mask = decode_mask(file.read_bytes(), file.suffix) if file.is_file() else None
    if mask is None:
        raise SupervisionError(f"mask {file} does not decode as an image; replace it")
    if mask.shape != sides:
        raise SupervisionError(
            f"mask {file} is {mask.shape[1]}x{mask.shape[0]} but the clip is {sides[1]}x{sides[0]}; resize it"
        )
    return mask
