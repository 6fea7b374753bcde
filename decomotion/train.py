"""Fits a model to a clip: begin a run, or find one that was begun; then optimise."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
import yaml

from decomotion import checkpoint, losses, shots
from decomotion.chance import first_weights
from decomotion.checkpoint import ClipFacts
from decomotion.clip import Clip, read_clip
from decomotion.config import Config
from decomotion.config import load as load_config
from decomotion.data.pool import Pool
from decomotion.data.prepare import affordable, prepare
from decomotion.device import choose_device
from decomotion.errors import CheckpointError
from decomotion.files import replacing
from decomotion.geometry import ImagePlane
from decomotion.model.fusion import DecoMotion
from decomotion.presets import AUTO_PRESET
from decomotion.run import Run, Stopping, never
from decomotion.schedule import Budget

log = logging.getLogger(__name__)


def fit(
    clip: Clip | str | Path,
    out: str | Path | None = None,
    *,
    config: Config | None = None,
    steps: int | None = None,
    time_budget: float | None = None,
    resume: bool = False,
    rebuild_cache: bool = False,
    seed: int = 0,
    device: str = "auto",
    progress: bool = True,
    ignore_cuts: bool = False,
    stopping: Stopping = never,
) -> Path:
    """Fits one model to one clip.

    Args:
        clip: a clip, or the path of one (`decomotion.clip.read_clip`).
        out: the run's folder; default `runs/<clip name>`.
        config: the configuration; default: the `cpu` preset.
        steps: number of optimisation steps; default: the configuration's.
        time_budget: seconds that the whole call may take; the schedules are fitted to it, and a short one thins the
            gaps at which flow is computed, and the points that are linked (`decomotion.data.prepare.affordable`).
            Excludes `steps`.
        resume: continue the run in `out`, with its own configuration and seed, and its budget where none is given.
        rebuild_cache: prepare the supervision anew.
        seed: of everything random, the points that are prepared included (`decomotion.chance`).
        device: `auto`, `cpu`, `cuda` or any name torch knows.
        progress: show a progress bar.
        ignore_cuts: fit the clip even where it cuts from one shot to another.
        stopping: says when to stop between two steps, and save; by default nobody does, and Ctrl-C leaves the last
            checkpoint.

    Returns: the run's folder, which holds `checkpoint.pt`, `config.yaml`, TensorBoard logs and previews.

    Raises: `ClipError` where the clip cannot be read or has cuts, `SupervisionError`, `CheckpointError`;
        `TrainingError` where a loss is not a number, `KeyboardInterrupt` where it was told to stop.
    """
    begin = time.monotonic()
    clip = clip if isinstance(clip, Clip) else read_clip(clip)
    folder = Path(out) if out is not None else Path("runs") / clip.name
    where = torch.device(choose_device(device))
    if resume:
        run = _resumed(folder, clip, where, progress)
    else:
        config = config or load_config(AUTO_PRESET)
        losses.check(config.loss, config.model.volumes)
        if not ignore_cuts:
            shots.check_one_shot(clip)
        if time_budget is not None:
            data = affordable(clip, config.data, time_budget, seed=seed, rebuild=rebuild_cache)
            config = config.model_copy(update={"data": data})  # in the run's own, so that it finds these links again
        pool = prepare(clip, config.data, seed=seed, rebuild=rebuild_cache, progress=progress, device=str(where))
        run = _begun(folder, clip, config, pool, where, seed)
    if not resume or steps is not None or time_budget is not None:
        run.budget = Budget(steps or run.config.optim.steps, time_budget)
    with _says_how_to_resume(folder):
        run.loop(begin, progress, stopping)
    return folder


def _begun(folder: Path, clip: Clip, config: Config, pool: Pool, device: torch.device, seed: int) -> Run:
    """A run at its first step, in a folder of which all that was of a former run is gone."""
    for former in ("previews", "tensorboard"):
        shutil.rmtree(folder / former, ignore_errors=True)
    (folder / shots.FILE_NAME).unlink(missing_ok=True)
    with replacing(folder / "config.yaml") as file:
        file.write_text(yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
    starts = (start_maps(config.model.static.start, pool), start_maps(config.model.dynamic.start, pool))
    with first_weights(seed):
        model = DecoMotion(config.model, ImagePlane(clip.height, clip.width), starts, pool.feature_size)
    return Run(folder, ClipFacts.of(clip), config, model.to(device), pool, seed)


def _resumed(folder: Path, clip: Clip, device: torch.device, progress: bool) -> Run:
    """The run in `folder` as its checkpoint has it. Raises `CheckpointError` where it is another clip's."""
    saved = checkpoint.load(folder / checkpoint.FILE_NAME, device)
    if saved.clip.digest != clip.digest():
        raise CheckpointError(
            f"{folder} was fitted to another clip ({saved.clip.name}, {saved.clip.num_frames} frames of "
            f"{saved.clip.width}x{saved.clip.height}); give that clip, or another --out"
        )
    seed = saved.training["seed"]
    pool = prepare(clip, saved.config.data, seed=seed, progress=progress, device=str(device))
    run = Run(folder, saved.clip, saved.config, saved.model, pool, seed)
    run.restore(saved.training)
    return run


def start_maps(kind: str, pool: Pool) -> torch.Tensor:
    """Affine maps from local to canonical space that a volume starts with, [frame, 3, 4]."""
    maps = torch.eye(3, 4).repeat(pool.num_frames, 1, 1)
    if kind != "identity":
        planar = torch.from_numpy((pool.camera if kind == "camera" else pool.object).copy())
        maps[:, :2, :2] = planar[..., :2]
        maps[:, :2, 3] = planar[..., 2]
    return maps


@contextmanager
def _says_how_to_resume(folder: Path) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        log.info("decomo-train on the same clip with --resume --out %s goes on", folder)
        raise
