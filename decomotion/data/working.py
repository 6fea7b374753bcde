"""The stage `frames`: the clip at the size that preparation works at, read once and in order, mapped from disk.

What follows reads frames from there, in any order: they are never all in memory, nor decoded a second time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from decomotion.arrays import allocated_memmap
from decomotion.clip import Clip
from decomotion.data.flow.config import FlowConfig
from decomotion.data.flow.interface import kept, resized
from decomotion.memory import forget

LEAST_SIDE = 512
"""Longer side that features, masks and the refinement of matches look at, at most; flow may want more."""
FRAMES = "frames.npy"


def working_side(flow: FlowConfig) -> int:
    """Longer side of the frames that preparation needs at most."""
    return max(LEAST_SIDE, getattr(flow, "max_side", LEAST_SIDE))


def build_frames(clip: Clip, side: int, progress: bool, folder: Path) -> dict[str, Any]:
    """Fills the stage's folder: uint8 [frame, h, w, 3], no side longer than `side`; smaller frames stay as they are.

    Raises `OSError` where the disk has no room for them.
    """
    size = kept(clip.height, clip.width, side)
    frames = allocated_memmap(folder / FRAMES, np.uint8, (len(clip), size[1], size[0], 3))
    shown = tqdm(clip.frames, "frames", total=len(clip), disable=not progress, leave=False)
    for number, frame in enumerate(shown):
        frames[number] = resized(frame, size)
        forget(frames)
    frames.flush()
    return {"size": size}


def working_clip(clip: Clip, folder: Path) -> Clip:
    """The clip at the size that preparation works at: its frames lie in the stage's folder, of which none is loaded."""
    frames = np.load(folder / FRAMES, mmap_mode="r")
    return Clip(clip.name, frames, times=clip.times, pixel_aspect=clip.pixel_aspect)
