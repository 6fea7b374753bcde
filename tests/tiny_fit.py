"""What a fit in seconds needs: a clip whose motion is known, settings to match, and models without a fit."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.clip import Clip

if TYPE_CHECKING:
    from torch import Tensor, nn

    from decomotion.model.fusion import DecoMotion

    Module = TypeVar("Module", bound=nn.Module)

FRAMES, HEIGHT, WIDTH, SQUARE = 8, 28, 40, 12
SCENE_VELOCITY = np.array([-1.0, 0.0], np.float32)
"""Pixels a frame, (x, y), of the textured background."""
SQUARE_VELOCITY = np.array([2.0, 0.0], np.float32)
SQUARE_START = np.array([2.0, 10.0], np.float32)
"""The square's upper left pixel in frame 0, (x, y)."""

TINY = (
    "data.flow={kind: dis, field_side: 512, intervals: [1, 2, 4], longest_interval: 16, upsample: 2, max_side: 64, "
    "patch_stride: 3, descent_iterations: 25, refinement_iterations: 10, gradient_weight: 10, alone: true}",
    "data.pool.points_per_frame=256",
    "optim.pairs=4",
    "optim.points=32",
    "log.scalars_every=1",
    "log.previews=1",
    "data.matching.intervals=[]",  # on 32 pixels nothing can be told by its looks
)
TINY_CPU = (
    *TINY,
    "data.feature_size=4",
    "model.samples=6",
    "model.frame_code.size=8",
    "model.static.couplings=1",
    "model.dynamic.couplings=2",
    *(f"model.{volume}.affine_hidden=8" for volume in ("static", "dynamic")),
    *(
        f"model.{volume}.conditioner={{kind: grid, cells: [2, 4], rank: 3, slope: 0.5}}"
        for volume in ("static", "dynamic")
    ),
    *(
        f"model.{field}={{kind: grid, width: 8, channels: 4, image_cells: [8], depth_cells: 4}}"
        for field in ("static.field", "dynamic.field", "feature_field")
    ),
)
"""The `cpu` preset in the same form and of the least size."""
AFFINE = ("model.volumes=static", "model.static.couplings=0")
"""One volume without a network: where a fit is exported and not looked at, half of the exporter's time."""
TINY_PAPER = (
    *TINY,
    "data.features=none",
    "model.samples=4",
    "model.frame_code.size=8",
    "model.frame_code.hidden=8",
    "model.static.couplings=1",
    "model.dynamic.couplings=2",
    *(f"model.{volume}.affine_hidden=8" for volume in ("static", "dynamic")),
    *(
        f"model.{volume}.conditioner={{kind: mlp, frequencies: 2, encoding: 8, hidden: 8, layers: 2}}"
        for volume in ("static", "dynamic")
    ),
    *(
        f"model.{field}={{kind: gabor, width: 8, layers: 2, input_scale: 8.0, alpha: 3.0}}"
        for field in ("static.field", "dynamic.field", "feature_field")
    ),
)
"""The `paper` preset, likewise."""
TINY_PRESETS = {"cpu": TINY_CPU, "omnimotion": TINY_CPU, "paper": TINY_PAPER}


def sliding_square(frames: int = FRAMES) -> Clip:
    """A textured square slides to the right over a textured scene that slides to the left, whole pixels a frame."""
    random = np.random.default_rng(0)
    scene = texture(random, HEIGHT, WIDTH + frames, grain=1.5)
    square = texture(random, SQUARE, SQUARE, grain=1.0)
    video = []
    for frame in range(frames):
        picture = scene[:, frame : frame + WIDTH].copy()
        x, y = (SQUARE_START + frame * SQUARE_VELOCITY).astype(int)
        picture[y : y + SQUARE, x : x + SQUARE] = square
        video.append(picture)
    return Clip("sliding", np.stack(video), 24.0)


def texture(random: np.random.Generator, height: int, width: int, grain: float) -> npt.NDArray[np.uint8]:
    noise = cv2.GaussianBlur(random.random((height, width, 3), np.float32), (0, 0), grain)
    return np.round(255 * (noise - noise.min()) / (noise.max() - noise.min())).astype(np.uint8)


def on_square(xy: npt.NDArray, frame: npt.NDArray | int, margin: float = 0.0) -> npt.NDArray[np.bool_]:
    """Whether positions [..., 2] lie on the square, and at least `margin` pixels from its outline."""
    corner = SQUARE_START + np.asarray(frame)[..., None] * SQUARE_VELOCITY - 0.5
    return np.asarray(((xy > corner + margin) & (xy < corner + SQUARE - margin)).all(-1))


def true_target(xy: npt.NDArray, frame: npt.NDArray | int, target: npt.NDArray | int) -> npt.NDArray:
    """Where what is seen at `xy` [..., 2] in `frame` lies in frame `target`."""
    velocity = np.where(on_square(xy, frame)[..., None], SQUARE_VELOCITY, SCENE_VELOCITY)
    return xy + (np.asarray(target) - np.asarray(frame))[..., None] * velocity


def write_frames(clip: Clip, folder: Path) -> Path:
    """The clip as a folder of PNGs."""
    folder.mkdir(parents=True)
    for index, frame in enumerate(clip.frames):
        cv2.imwrite(str(folder / f"{index:05d}.png"), cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    return folder


def write_truth(clip: Clip, path: Path) -> Path:
    """Five true tracks of the clip in TAP-Vid's form: three on the square, two on the scene that it never covers."""
    start = np.array([[5, 13], [8, 16], [11, 19], [20, 4], [24, 27]], np.float32)
    frame = np.arange(len(clip))
    tracks = true_target(start[:, None], np.zeros(1, int), frame[None])
    record = {
        "video": clip.frames,
        "points": (tracks + 0.5) / (WIDTH, HEIGHT),
        "occluded": np.zeros(tracks.shape[:2], np.bool_),
    }
    path.write_bytes(pickle.dumps({clip.name: record}))
    return path


def tiny_model(
    preset: str,
    *,
    frames: int = 5,
    height: int = 24,
    width: int = 32,
    feature_size: int = 3,
    start: Tensor | None = None,
    overrides: tuple[str, ...] = (),
) -> DecoMotion:
    """A model as it is before a fit; `start` are the affine maps [frame, 3, 4] of both volumes, default: identity."""
    import torch

    from decomotion.config import load
    from decomotion.geometry import ImagePlane
    from decomotion.model.fusion import DecoMotion

    torch.manual_seed(0)
    config = load(preset, overrides=(*TINY_PRESETS[preset], *overrides)).model
    start = torch.eye(3, 4).repeat(frames, 1, 1) if start is None else start
    return DecoMotion(config, ImagePlane(height, width), (start, start.clone()), feature_size)


def offsets(model: DecoMotion, xy: Tensor, seed: int = 0) -> Tensor:
    """Where in its bin each sample of the rays through `xy` [pair, point, 2] lies, drawn as in a fit."""
    import torch

    generator = torch.Generator().manual_seed(seed)
    return torch.rand((*xy.shape[:2], model.config.samples), generator=generator)


def randomised(module: Module, scale: float = 0.2, seed: int = 0) -> Module:
    """The module, noise added to all of its parameters: nothing is zero or the identity any more."""
    import torch

    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += scale * torch.randn(parameter.shape, dtype=parameter.dtype, generator=generator)
    return module
