"""The stage `motion`: what moves, and the motion of the camera and of the object in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.clip import Clip
from decomotion.data import camera, masks
from decomotion.data.pool import UNKNOWN_MOTION, Positions


def build_motion(
    clip: Clip,
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    grid: tuple[int, int],
    kind: str,
    given: npt.NDArray[np.bool_] | None,
    folder: Path,
) -> dict[str, Any]:
    """Fills the stage's folder with moving, camera and object.

    Args:
        clip: the clip.
        points: [frame, point, 2], of which the first form the jittered grid.
        targets: [frame, frame, point, 2], where they lie in the other frames.
        confidence: [frame, frame, point].
        grid: rows and columns of the jittered grid.
        kind: `auto`, `none`, or a folder's name.
        given: the user's masks [frame, H, W], where `kind` is a folder.
        folder: of the stage.
    """
    moving = _moving(clip, points, targets, confidence, grid, kind, given)
    np.save(folder / "moving.npy", moving)
    usable = confidence > 0
    unit = max(clip.height, clip.width) / 256
    of_scene = camera.chain(points, targets, usable & (moving != 1)[:, None], unit)
    of_object = camera.chain(points, targets, usable & (moving != 0)[:, None], unit, similarity=True, fallback=of_scene)
    for name, maps in (("camera", of_scene), ("object", of_object)):
        np.save(folder / f"{name}.npy", camera.to_normalised(maps, clip.height, clip.width))
    return {"moving": None if kind == "none" else float((moving == 1).mean())}


def _moving(
    clip: Clip,
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    grid: tuple[int, int],
    kind: str,
    given: npt.NDArray[np.bool_] | None,
) -> npt.NDArray[np.uint8]:
    """[frame, point]: 1 on what moves, 0 on the scene; `UNKNOWN_MOTION` everywhere with masks `none`."""
    if kind == "none":
        return np.full(points.shape[:2], UNKNOWN_MOTION, np.uint8)
    if given is None:
        on_grid = grid[0] * grid[1]
        on_it = targets.first_points(on_grid) if not isinstance(targets, np.ndarray) else targets[:, :, :on_grid]
        given = masks.auto_masks(clip.frames, points[:, :on_grid], on_it, confidence[:, :, :on_grid], grid)
    nearest = np.round(points).astype(np.int64)
    frame = np.arange(len(points))[:, None]
    return given[frame, nearest[..., 1], nearest[..., 0]].astype(np.uint8)
