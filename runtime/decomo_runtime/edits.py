"""Pictures painted over one frame, moved with what they are painted on through all others, over the clip's own pixels.

Each pixel of a frame asks the model where it was in the painted frame, and takes the colour of the picture there. What
hides the painted surface is in front of it, and what was hidden in the painted frame is not painted. An edit may be
given to the static scene alone, or to the moving objects alone; one of the scene goes on behind objects that hide the
scene in the painted frame, as the scene around them moves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.dense import dense_flows
from decomo_runtime.dense_maps import DenseMap, identity, smoothed
from decomo_runtime.errors import RenderError
from decomo_runtime.footage import FramesByNumber, check_footage
from decomo_runtime.layers import pixel_queries
from decomo_runtime.mipmaps import Mipmaps
from decomo_runtime.options import DYNAMIC, OWNERS, SEEN, STATIC, file_and_frame
from decomo_runtime.queries import check_frames
from decomo_runtime.raster import Raster, around
from decomo_runtime.sampling import sampled
from decomo_runtime.scene_maps import OBJECT_SHARE, SceneMaps
from decomo_runtime.scene_motion import follow_scene
from decomotion.frame_files import decode_rgba
from decomotion.images import filled

if TYPE_CHECKING:
    from decomo_runtime.model_file import ModelFacts
    from decomo_runtime.tracker import Tracker

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]

SHAPE_TOLERANCE = 0.02
"""By which a picture may be wider or higher than the frame, once brought to the other side's length."""
SHADED = 3.0
"""Deviation over which shading is compared, in pixels of a frame whose longer side is 256."""
MOST_GAIN = 4.0
"""Light changes at most by so much, either way."""
REACH = 2.5
"""Such deviations."""
_SHOWN = 0.05
"""Of what is around, by weight: where less is in sight in both frames, light is that of the parts beside."""
_DARK = 6.0
"""Of 255: darker pixels tell little of the light."""
_WHOLLY = 0.75
"""Share of a pixel's ray that makes it wholly an object's; `OBJECT_SHARE` and less make it not an object's."""


@dataclass(frozen=True, eq=False)
class Edit:
    """A picture over a frame."""

    picture: Image
    """[h, w, 4], RGBA, alpha not premultiplied; it covers the frame, whatever its size."""
    frame: int
    """Over which it was painted."""
    on: str = SEEN
    """What it belongs to: one of `OWNERS`."""
    name: str = "edit"
    """For messages."""

    @cached_property
    def mipmaps(self) -> Mipmaps:
        """The picture, to be read."""
        return Mipmaps(self.picture)


def read_edit(text: str, on: str = SEEN) -> Edit:
    """The edit `"PICTURE@T"`: a PNG with alpha, and the frame that it was painted over.

    `RenderError` where the text is not of that form, or the file does not decode.
    """
    path, frame = file_and_frame(text)
    if frame is None:
        raise RenderError(f"--edit {text} is not PICTURE@T: a PNG with alpha and a frame, such as logo.png@0")
    try:
        picture = decode_rgba(path.read_bytes())
    except OSError as error:
        raise RenderError(f"--edit {path} cannot be read ({error.strerror}); give a PNG with alpha") from error
    if picture is None:
        raise RenderError(f"--edit {path} does not decode as an image; give a PNG with alpha")
    return Edit(picture, frame, on, str(path))


def check_edit(edit: Edit, model: ModelFacts) -> None:
    """`RenderError` where the edit is of a frame that the clip does not have, of another shape, empty or opaque."""
    if edit.on not in OWNERS:
        raise RenderError(f"{edit.name} cannot be on {edit.on!r}; choose from {', '.join(OWNERS)}")
    if not 0 <= edit.frame < model.num_frames:
        raise RenderError(
            f"{edit.name} is over frame {edit.frame}, which must be within 0 .. {model.num_frames - 1}, the clip's"
        )
    if edit.picture.ndim != 3 or edit.picture.shape[2] != 4 or edit.picture.dtype != np.uint8:
        raise RenderError(f"{edit.name} must be RGBA, uint8 [h, w, 4], got {edit.picture.dtype} {edit.picture.shape}")
    height, width = edit.picture.shape[:2]
    ratio = width / height
    shapes = model.width / model.height, model.width * model.pixel_aspect / model.height
    if all(abs(math.log(ratio / shape)) > SHAPE_TOLERANCE for shape in shapes):
        raise RenderError(
            f"{edit.name} is {width}x{height}, of another shape than the clip's frames of "
            f"{model.width}x{model.height}, so that it cannot be laid over one; paint on a frame of the clip"
        )
    if not edit.picture[..., 3].any():
        raise RenderError(f"{edit.name} is transparent everywhere: there is nothing to draw")
    if edit.picture[..., 3].min() == 255:
        raise RenderError(
            f"{edit.name} has no alpha, or is opaque everywhere, so that it would cover all of the frame; "
            "save it with a transparent ground"
        )


def draw_edits(
    tracker: Tracker,
    frames: FramesByNumber,
    edits: Sequence[Edit],
    wanted: Iterable[int],
    *,
    relight: bool = False,
    alone: bool = False,
) -> Iterator[Image]:
    """Yields the `wanted` frames with the edits on them, uint8 [H, W, 3] RGB; the last edit lies on top.

    Args:
        tracker: the model.
        frames: the whole clip, each uint8 [H, W, 3] RGB.
        edits: one or more.
        wanted: numbers of frames.
        relight: edits become brighter and darker with the clip, from the painted frame on.
        alone: the edits without the clip, uint8 [H, W, 4] RGBA, alpha not premultiplied.

    Raises `RenderError` as `check_edit`, and where an edit is on the static scene and the model holds nothing to be
    static; `OverlayError` where `frames` are of another clip, `QueryError` where a wanted frame is none of it.
    """
    check_footage(frames, tracker.facts)
    for edit in edits:
        check_edit(edit, tracker.facts)
    scene = SceneMaps(tracker, follow_scene(tracker)) if any(edit.on == STATIC for edit in edits) else None
    return _drawn(tracker, frames, edits, wanted, scene, relight, alone)


def _drawn(
    tracker: Tracker,
    frames: FramesByNumber,
    edits: Sequence[Edit],
    wanted: Iterable[int],
    scene: SceneMaps | None,
    relight: bool,
    alone: bool,
) -> Iterator[Image]:
    painted = sorted({edit.frame for edit in edits})
    shown = {frame: frames[frame] for frame in painted} if relight else {}
    for frame in wanted:
        (frame,) = check_frames([frame], tracker.num_frames).tolist()
        view = _View(tracker, frame, painted, scene)
        layer = np.zeros((tracker.height, tracker.width, 4), np.float32)
        for edit in edits:
            own = view.moved(edit)
            region = around(own[..., 3] > 0) if relight else None
            if region is not None:
                lit = own[region.part]
                lit[..., :3] *= view.light(edit, region, frames[frame], shown[edit.frame])
                lit[..., :3] = np.minimum(lit[..., :3], lit[..., 3:])
            layer = (own + (1 - own[..., 3:]) * layer).astype(np.float32, copy=False)
        yield _straight(layer) if alone else _over(layer, frames[frame])


class _View:
    """One frame, and where its pixels were in the painted ones."""

    def __init__(self, tracker: Tracker, frame: int, painted: Sequence[int], scene: SceneMaps | None) -> None:
        self._tracker, self._frame, self._scene = tracker, frame, scene
        size = tracker.height, tracker.width
        others = [each for each in painted if each != frame]
        answers = dense_flows(tracker, frame, others)
        maps = {each: smoothed(dense, tracker.occlusion_threshold) for each, dense in zip(others, answers, strict=True)}
        self._maps = {frame: identity(*size), **maps}
        self._of_scene: dict[int, DenseMap] = {}
        self._share: Floats = np.full(size, np.nan, np.float32)

    def moved(self, edit: Edit) -> Floats:
        """[H, W, 4], premultiplied RGBA: the edit as it is in this frame."""
        there = self._map(edit)
        height, width = there.visible.shape
        layer = np.zeros((height, width, 4), np.float32)
        ratio = np.array([edit.picture.shape[1] / width, edit.picture.shape[0] / height], np.float32)
        candidates = there.visible > 0
        places = (there.places[candidates] + 0.5) * ratio - 0.5
        layer[candidates] = edit.mipmaps.read(places, there.scale[candidates] * ratio.max())
        layer *= there.visible[..., None]
        if edit.on != SEEN:
            share = self._object_share(layer[..., 3] > 0)
            layer *= (share if edit.on == DYNAMIC else 1 - share)[..., None]
        return layer

    def light(self, edit: Edit, region: Raster, here: Image, painted: Image) -> Floats:
        """[h, w, 3] in a region: what the clip's colours are there, over large parts, of those in the painted frame."""
        deviation = SHADED * max(here.shape) / 256
        wide, there = region.grown(math.ceil(REACH * deviation)), self._maps[edit.frame]
        places, inside = there.places[wide.part], np.ones(painted.shape[:2], np.float32)
        weight = (there.visible[wide.part] * sampled(inside, places, outside=0))[..., None]
        known, now, then = (
            cv2.GaussianBlur(image, (0, 0), deviation).reshape(*wide.shape, -1)
            for image in (weight, weight * here[wide.part], weight * sampled(painted, places))
        )
        gain = (now + _DARK * known) / np.maximum(then + _DARK * known, 1e-3)
        gain = filled(gain.astype(np.float32), (known[..., 0] > _SHOWN).astype(np.float32))
        rows, columns = (
            slice(part.start - all_of.start, part.stop - all_of.start)
            for part, all_of in zip(region.part, wide.part, strict=True)
        )
        return gain[rows, columns].clip(1 / MOST_GAIN, MOST_GAIN)

    def _map(self, edit: Edit) -> DenseMap:
        seen = self._maps[edit.frame]
        if edit.on != STATIC or edit.frame == self._frame or self._scene is None:
            return seen
        if edit.frame not in self._of_scene:
            self._of_scene[edit.frame] = self._scene.between(self._frame, edit.frame, seen)
        return self._of_scene[edit.frame]

    def _object_share(self, pixels: npt.NDArray[np.bool_]) -> Floats:
        """[H, W] in [0, 1], how much an object has of each pixel; only those asked for are rendered."""
        asked = pixels & np.isnan(self._share)
        if asked.any():
            queries = pixel_queries(self._frame, pixels.shape, self._tracker.facts)[asked.ravel()]
            moving = 1 - self._tracker.sample(queries).static_confidence
            self._share[asked] = ((moving - OBJECT_SHARE) / (_WHOLLY - OBJECT_SHARE)).clip(0, 1)
        return np.where(pixels, np.nan_to_num(self._share), 0)


def _over(layer: Floats, picture: Image) -> Image:
    """The layer, premultiplied RGBA, over the picture, whose other pixels stay as they are."""
    mixed = 255 * layer[..., :3] + (1 - layer[..., 3:]) * picture
    return np.where(layer[..., 3:] > 0, np.rint(mixed).clip(0, 255), picture).astype(np.uint8)


def _straight(layer: Floats) -> Image:
    """Premultiplied RGBA as uint8 that is not."""
    colours = layer[..., :3] / np.maximum(layer[..., 3:], 1e-6)
    return np.rint(255 * np.dstack([colours, layer[..., 3]])).clip(0, 255).astype(np.uint8)
