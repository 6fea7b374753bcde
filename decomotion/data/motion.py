"""The stage `motion`: what moves, and the motion of the camera and of the object in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.clip import Clip
from decomotion.data import camera
from decomotion.data.masks.auto import auto_masks
from decomotion.data.pool import UNKNOWN_MOTION, Positions
from decomotion.units import unit


def build_motion(
    clip: Clip,
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    grid: tuple[int, int],
    kind: str,
    given: npt.NDArray[np.bool_] | None,
    random: np.random.Generator,
    progress: bool,
    folder: Path,
) -> dict[str, Any]:
    """Fills the stage's folder with camera, object and moving, which is `UNKNOWN_MOTION` everywhere without masks.

    Args:
        clip: the clip.
        points: [frame, point, 2], of which the first form the jittered grid.
        targets: [frame, frame, point, 2], where they lie in the other frames.
        confidence: [frame, frame, point].
        grid: rows and columns of the jittered grid.
        kind: `auto`; `none`, for which nothing is known; or a folder's name.
        given: the user's masks [frame, H, W], where `kind` is a folder.
        random: draws the points that masks `auto` are found from.
        progress: show a progress bar.
        folder: of the stage.
    """
    if kind == "none":
        moving = np.full(points.shape[:2], UNKNOWN_MOTION, np.uint8)
    else:
        if given is None:
            given = auto_masks(clip.frames, points, targets, confidence, grid, random, progress)
        moving = moving_at(points, given)
    of_scene, of_object = closed_form(clip, points, targets, confidence, moving)
    for name, array in (("moving", moving), ("camera", of_scene), ("object", of_object)):
        np.save(folder / f"{name}.npy", array)
    return {"moving": None if kind == "none" else float((moving == 1).mean())}


def moving_at(points: npt.NDArray[np.float32], given: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    """Masks [frame, H, W] read at points [frame, point, 2] in pixels: [frame, point], 1 on what moves."""
    nearest = np.round(points).astype(np.int64)
    frame = np.arange(len(points))[:, None]
    return given[frame, nearest[..., 1], nearest[..., 0]].astype(np.uint8)


def closed_form(
    clip: Clip,
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    moving: npt.NDArray[np.uint8],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Affine maps of the scene and similarities of what moves, to the middle frame, [frame, 2, 3], normalised.

    Points of unknown motion count for both.
    """
    usable = confidence > 0
    length = unit(clip.height, clip.width)
    of_scene = camera.chain(points, targets, usable & (moving != 1)[:, None], length)
    of_object = camera.chain(
        points, targets, usable & (moving != 0)[:, None], length, similarity=True, fallback=of_scene
    )
    return (
        camera.to_normalised(of_scene, clip.height, clip.width),
        camera.to_normalised(of_object, clip.height, clip.width),
    )
