"""The stage `motion`: what moves, how camera and object move in closed form, and the scene's structure."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.data import camera
from decomotion.data.masks.auto import moves_at
from decomotion.data.pool import UNKNOWN_MOTION
from decomotion.data.positions import Positions
from decomotion.data.sampling import nearest, rescaled
from decomotion.data.structure import structure
from decomotion.units import unit


def build_motion(
    sides: tuple[int, int],
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    masks: Iterable[npt.NDArray[np.bool_]] | None,
    probability: npt.NDArray[np.float32] | None,
    random: np.random.Generator,
    folder: Path,
) -> dict[str, Any]:
    """Fills the stage's folder with camera, object, the arrays of the scene's `Structure`, and moving, which is
    `UNKNOWN_MOTION` everywhere without masks.

    Args:
        sides: height and width of the clip, in whose pixels positions are.
        points: [frame, point, 2].
        targets: [frame, frame, point, 2], where they lie in the other frames.
        confidence: [frame, frame, point].
        masks: of what moves, [H, W] at any size, one a frame; or
        probability: that what lies in a frame moves, [frame, row, column]; or neither.
        random: draws the points that the structure's cameras are fitted to.
        folder: of the stage.
    """
    if masks is not None:
        at = [nearest(mask, rescaled(xy, sides, mask.shape)) for mask, xy in zip(masks, points, strict=True)]
    elif probability is not None:
        at = [moves_at(values, xy, sides) for values, xy in zip(probability, points, strict=True)]
    else:
        at = [np.full(len(xy), UNKNOWN_MOTION, np.uint8) for xy in points]
    moving = np.stack(at).astype(np.uint8)
    of_scene, of_object = closed_form(sides, points, targets, confidence, moving)
    scene = structure(points, targets, confidence, moving != 1, sides, random)
    for name, array in vars(scene).items():
        np.save(folder / f"{name}.npy", array)
    for name, array in (("moving", moving), ("camera", of_scene), ("object", of_object)):
        np.save(folder / f"{name}.npy", array)
    known = masks is not None or probability is not None
    return {"moving": float((moving == 1).mean()) if known else None}


def closed_form(
    sides: tuple[int, int],
    points: npt.NDArray[np.float32],
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    moving: npt.NDArray[np.uint8],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Affine maps of the scene and similarities of what moves, to the middle frame, [frame, 2, 3], normalised.

    Points of unknown motion count for both.
    """
    length = unit(*sides)
    of_scene = camera.chain(points, targets, confidence, moving != 1, length)
    of_object = camera.chain(points, targets, confidence, moving != 0, length, similarity=True, fallback=of_scene)
    return camera.to_normalised(of_scene, *sides), camera.to_normalised(of_object, *sides)
