"""Masks `rigid-first`: no segmenter at all. The static volume is fitted alone; what it cannot explain moves.

The paper names this as future work and leaves it open. Here: the first `SHARE` of the run is a run of its own, of a
static volume alone, on all correspondences with a loss by which those far off hardly pull (`losses/robust_flow.py`).
How far its answers then lie from the links is evidence of motion, and is labelled as that of `auto` is
(`data/labelling.py`). The usual fit goes on from there, with these masks and with the static volume as it is.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from decomotion.clip import Clip
from decomotion.config import Config
from decomotion.data.evidence import Evidence, in_units, neighbours, quantile
from decomotion.data.labelling import CHANGE_RANGE
from decomotion.data.masks import labelled_masks
from decomotion.data.motion import closed_form, moving_at
from decomotion.data.pool import Pool
from decomotion.errors import CheckpointError
from decomotion.files import replacing
from decomotion.model.fusion import DecoMotion
from decomotion.model.readout import carry, surface_of

RIGID_FIRST = "rigid-first"
"""Value of `data.masks`."""
SHARE = 0.2
"""Of the run's steps, or of its time, that the static volume has for itself."""
FOLDER = "rigid"
"""In the run's folder: the run of the static volume."""
MOTION = "motion.npz"
"""In it: the masks."""
REGULARISERS = ("distortion", "depth_range")
"""Losses that this run has besides the robust one, weighted as in the whole run."""


def rigid_config(config: Config) -> Config:
    """The configuration of the run of the static volume alone."""
    loss = {name: weight for name, weight in config.loss.items() if name in REGULARISERS}
    return config.model_copy(
        update={
            "model": config.model.model_copy(update={"volumes": "static"}),
            "loss": {"flow_robust": 1.0, **loss},
        }
    )


@torch.no_grad()
def rigid_residual(model: DecoMotion, pool: Pool) -> npt.NDArray[np.float32]:
    """How far a model's answers lie from the links, [frame, point], units per square root of the gap.

    The median over the frames around in which the point is seen; NaN where it is seen in none.
    """
    device = next(model.parameters()).device
    unit = model.plane.pixels_per_unit / 128
    conditioning = model.condition(torch.arange(pool.num_frames, device=device))
    residual = []
    for frame in range(pool.num_frames):
        xy = torch.from_numpy(np.array(pool.points[frame])).to(device)
        surface = surface_of(model, xy[None], conditioning, torch.tensor([frame], device=device))
        distances = []
        for other in neighbours(frame, pool.num_frames):
            there = carry(model, surface, conditioning, torch.tensor([other], device=device))[0].cpu().numpy()
            distance = np.linalg.norm(there - pool.targets[frame, other], axis=-1) / unit / abs(other - frame) ** 0.5
            distances.append(np.where(pool.confidence[frame, other] > 0, distance, np.nan))
        residual.append(quantile(distances, 0.5))
    return np.stack(residual)


def seeded(pool: Pool, clip: Clip, grid: tuple[int, int], model: DecoMotion) -> Pool:
    """The pool with `moving` and `object` from what `model`, a static volume alone, cannot explain.

    `grid` is that of the pool's first points.
    """
    count = grid[0] * grid[1]
    residual = rigid_residual(model, pool)[:, :count]
    found = Evidence(residual, np.full_like(residual, CHANGE_RANGE[1]))  # the model's word is taken as it is
    images, size = in_units(clip.frames), (clip.height, clip.width)
    masks = labelled_masks(images, size, found, pool.points, pool.targets, pool.confidence, grid)
    moving = moving_at(pool.points, masks)
    _, of_object = closed_form(clip, pool.points, pool.targets, pool.confidence, moving)
    return dataclasses.replace(pool, moving=moving, object=of_object)


def save_motion(folder: Path, pool: Pool) -> None:
    """Keeps what `seeded` has found in the run's folder, for `load_motion`."""
    with replacing(folder / FOLDER / MOTION) as temporary, temporary.open("wb") as file:
        np.savez(file, moving=pool.moving, object=pool.object)


def load_motion(folder: Path, pool: Pool) -> Pool:
    """The pool with what `save_motion` has kept. Raises `CheckpointError` where it is missing."""
    path = folder / FOLDER / MOTION
    if not path.is_file():
        raise CheckpointError(f"{path} is missing, the masks of this run; train again without --resume")
    with np.load(path) as kept:
        return dataclasses.replace(pool, moving=kept["moving"], object=kept["object"])
