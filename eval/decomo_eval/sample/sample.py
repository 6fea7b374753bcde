"""The sample clip: frames, tracks and masks from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decomo_eval.sample.render import photograph, render_frame, render_layers
from decomo_eval.sample.scene import BACKGROUND, draw_scene
from decomo_eval.sample.truth import follow_points
from decomotion.errors import InputError

MIN_FRAMES, MAX_FRAMES = 2, 1000
MIN_SIZE, MAX_SIZE = 32, 1024


class SampleError(InputError):
    """The sample cannot be made as asked, or not written there."""


@dataclass(frozen=True)
class Sample:
    """A clip and its exact ground truth."""

    video: npt.NDArray[np.uint8]
    """[T, H, W, 3], RGB."""
    points: npt.NDArray[np.float32]
    """[N, T, 2], (x, y) in fractions of the raster: the centre of pixel i lies at (i + 0.5) / width."""
    occluded: npt.NDArray[np.bool_]
    """[N, T], True where a point is behind another layer or outside the frame."""
    masks: npt.NDArray[np.bool_]
    """[T, H, W], True where a moving object is seen."""


def generate(seed: int = 0, frames: int = 24, size: int = 256) -> Sample:
    """The clip of `seed`: the same motion at any number of frames and any frame size, spread over the frames.

    Raises `SampleError` where a number is out of range.
    """
    _check("the seed", seed, 0, None)
    _check("the number of frames", frames, MIN_FRAMES, MAX_FRAMES)
    _check("the frame size", size, MIN_SIZE, MAX_SIZE)
    scene_rng, point_rng, camera_rng = np.random.default_rng(seed).spawn(3)
    scene = draw_scene(scene_rng, size)
    times = np.linspace(0, 1, frames)
    phase = camera_rng.random()
    video = np.stack([photograph(render_frame(scene, time, size), time, phase, camera_rng) for time in times])
    layer_maps = np.stack([render_layers(scene, time, size) for time in times])
    truth = follow_points(scene, times, layer_maps, point_rng)
    return Sample(video, truth.points.astype(np.float32), truth.occluded, layer_maps != BACKGROUND)


def _check(what: str, value: int, low: int, high: int | None) -> None:
    if value < low or (high is not None and value > high):
        allowed = f"{low} or more" if high is None else f"between {low} and {high}"
        raise SampleError(f"{what} is {value} but must be {allowed}")
