"""Pictures of a frame's layers, every pixel a ray of the model.

    fused     both volumes together: the clip as the model has it
    static    the static volume alone: the scene, the objects gone; with alpha: transparent where it was never seen
    dynamic   the objects alone, with alpha: 1 - static confidence
    mask      the motion mask, soft: as white as what is rendered there moves
    depth     pseudo-depth by the perceptual colour map inferno: near is bright; one scale for all frames

A rendering of another size than the clip's covers the same area (`docs/conventions.md`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.contract import FARTHEST, HOLE, LAYERS
from decomo_runtime.errors import RenderError
from decomo_runtime.queries import check_frames

if TYPE_CHECKING:
    from decomo_runtime.model import Appearance
    from decomo_runtime.model_file import ModelFacts
    from decomo_runtime.tracker import Tracker

Image = npt.NDArray[np.uint8]


def render(
    tracker: Tracker, frame: int, layers: Sequence[str] = LAYERS[:1], *, long_side: int | None = None
) -> list[Image]:
    """The `layers` of one frame, uint8 [H, W, 3] RGB; `static` and `dynamic` [H, W, 4] RGBA.

    Alpha is not premultiplied.
    Their longer side has `long_side` pixels, by default the clip's. Raises `RenderError` for an unknown layer or a size
    below 1, `QueryError` for a frame that the clip does not have.
    """
    if isinstance(layers, str):
        raise RenderError(f"layers are given as a list, such as [{layers!r}]; got {layers!r}")
    for layer in layers:
        if layer not in LAYERS:
            raise RenderError(f"there is no layer {layer!r}; choose from {', '.join(LAYERS)}")
    size = raster_size(tracker.facts, long_side)
    seen = look(tracker, frame, size)
    return [picture(seen, layer, size) for layer in layers]


def raster_size(model: ModelFacts, long_side: int | None = None) -> tuple[int, int]:
    """(height, width) of a raster of the clip's shape whose longer side has `long_side` pixels."""
    if long_side is None:
        return model.height, model.width
    if isinstance(long_side, bool) or not isinstance(long_side, int | np.integer) or long_side < 1:
        raise RenderError(f"the longer side of a picture must have a whole number of pixels, got {long_side!r}")
    scale = long_side / max(model.height, model.width)
    return max(1, round(model.height * scale)), max(1, round(model.width * scale))


def look(tracker: Tracker, frame: int, size: tuple[int, int]) -> Appearance:
    """What the model sees along the rays of all pixels, row by row, of a (height, width) raster over `frame`."""
    (frame,) = check_frames([frame], tracker.num_frames)
    return tracker.sample(pixel_queries(int(frame), size, tracker.facts))


def pixel_queries(frame: int, size: tuple[int, int], model: ModelFacts) -> npt.NDArray[np.float32]:
    """[H W, 3] rows of (t, x, y): the centres of the pixels of a (height, width) raster over `frame`, row by row."""
    height, width = size
    y = (np.arange(height) + 0.5) * (model.height / height) - 0.5
    x = (np.arange(width) + 0.5) * (model.width / width) - 0.5
    rows = np.stack([np.full(size, frame), *np.meshgrid(x, y)], axis=-1)
    return rows.reshape(-1, 3).astype(np.float32)


def picture(seen: Appearance, layer: str, size: tuple[int, int]) -> Image:
    """One layer of what was seen at every pixel of a (height, width) raster; as `render`."""
    if layer == "mask":
        return _bytes(np.repeat(1 - seen.static_confidence[:, None], 3, axis=1), size)
    if layer == "depth":
        near = _bytes(1 - seen.depth[:, None] / FARTHEST, size)
        return cv2.cvtColor(cv2.applyColorMap(near, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB).astype(np.uint8)
    if layer == "dynamic":
        return _bytes(np.column_stack([seen.rgb_dynamic, 1 - seen.static_confidence]), size)
    if layer == "static":
        return _bytes(np.column_stack([seen.rgb_static, seen.static_opacity / HOLE]), size)
    return _bytes(seen.rgb, size)


def _bytes(values: npt.NDArray[np.float32], size: tuple[int, int]) -> Image:
    """[H W, C] in [0, 1] to uint8 [H, W, C]; what is not a number becomes 0."""
    return np.rint(np.nan_to_num(values).clip(0, 1) * 255).astype(np.uint8).reshape(*size, -1)
