"""Motion masks of the user: a folder of images, one a frame."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from decomotion.data.masks.auto import Mask
from decomotion.errors import SupervisionError
from decomotion.frame_files import decode_frame, images_in

log = logging.getLogger(__name__)

JPEG_BLACK = 127
"""A JPEG's edges ring: what is not brighter than this is black."""


def read_masks(folder: Path, frames: int, height: int, width: int) -> Mask:
    """Masks [frame, H, W] from a folder of images, one a frame in natural order; any pixel that is not black moves.

    Raises `SupervisionError` where they do not fit the clip.
    """
    if not folder.is_dir():
        raise SupervisionError(f"mask folder {folder} does not exist; give a folder of images, 'auto' or 'none'")
    files = images_in(folder)
    if len(files) != frames:
        raise SupervisionError(f"mask folder {folder} has {len(files)} images but the clip has {frames} frames")
    masks = []
    for file in files:
        image = decode_frame(file.read_bytes()) if file.is_file() else None
        if image is None:
            raise SupervisionError(f"mask {file} does not decode as an image; replace it")
        mask = image.max(axis=-1) > (0 if file.suffix.lower() == ".png" else JPEG_BLACK)
        if mask.shape != (height, width):
            raise SupervisionError(
                f"mask {file} is {mask.shape[1]}x{mask.shape[0]} but the clip is {width}x{height}; resize it"
            )
        masks.append(mask)
    if not any(mask.any() for mask in masks):
        log.warning("all masks in %s are black: nothing moves", folder)
    return np.stack(masks)
