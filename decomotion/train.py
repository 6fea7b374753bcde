"""Fits a model to a clip: begin a run, or find one that was begun; then optimise."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import torch
import yaml

from decomotion import checkpoint, losses, windows
from decomotion.chance import first_weights
from decomotion.checkpoint import Checkpoint, ClipFacts
from decomotion.clip import Clip, read_clip
from decomotion.config import Config
from decomotion.config import load as load_config
from decomotion.data.pool import Pool
from decomotion.data.prepare import affordable, prepare
from decomotion.device import choose_device
from decomotion.errors import CheckpointError
from decomotion.files import replacing
from decomotion.geometry import ImagePlane
from decomotion.long_clip import check_one_shot
from decomotion.model.fusion import DecoMotion
from decomotion.presets import AUTO_PRESET
from decomotion.record import CORRECTIONS, Record, check_resumable, read_record
from decomotion.record import FILE_NAME as RECORD
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

    Returns:
        the run's folder, which holds `checkpoint.pt`, `config.yaml`, TensorBoard logs and previews.

    Raises:
        ClipError: the clip cannot be read, or has cuts.
        SupervisionError: what the fit should learn from cannot be made or read.
        CheckpointError: there is nothing to resume, or what is there is of another clip.
        TrainingError: a loss is not a number.
        KeyboardInterrupt: it was told to stop.
    """
    begin = time.monotonic()
    clip = clip if isinstance(clip, Clip) else read_clip(clip)
    folder = Path(out) if out is not None else Path("runs") / clip.name
    where = torch.device(choose_device(device))
    saved = record = None
    if resume:
        saved, record = _left(folder, clip, where)
    if record is None:
        config = config or load_config(AUTO_PRESET)
        losses.check(config.loss, config.model.volumes)
        if not ignore_cuts:
            check_one_shot(clip)
        if time_budget is not None:
            how = {"seed": seed, "rebuild": rebuild_cache, "device": str(where)}
            data = affordable(clip, config.data, time_budget, **how)
            config = config.model_copy(update={"data": data})  # in the run's own, so that it finds these links again
        record = Record(clip.digest(), config, seed, Budget(steps or config.optim.steps, time_budget))
    elif steps is not None or time_budget is not None:
        record = replace(record, budget=Budget(steps or record.config.optim.steps, time_budget), finished=False)
    with _says_how_to_resume(folder):
        with _recorded(record, folder):
            options = {"seed": record.seed, "rebuild": rebuild_cache, "progress": progress, "device": str(where)}
            pool = prepare(clip, record.config.data, **options)
            run = _resumed(folder, saved, pool) if saved is not None else _begun(folder, clip, record, pool, where)
        run.budget = record.budget
        run.loop(begin, progress, stopping)
    record.finish(folder)
    return folder


def _left(folder: Path, clip: Clip, device: torch.device) -> tuple[Checkpoint | None, Record]:
    """What the run in `folder` has left: its checkpoint, if it came to one, and what it was begun with.

    A checkpoint that is not of the run that was begun last is of a former one. The budget is what was given last, which
    the checkpoint may not have heard of yet. Raises `CheckpointError` where there is neither, or the run is another
    clip's.
    """
    check_resumable(folder)
    record, file = read_record(folder), folder / checkpoint.FILE_NAME
    saved = checkpoint.load(file, device) if record is None or file.is_file() else None
    if saved is not None:
        of_saved = Record(saved.clip.digest, saved.config, saved.training["seed"], Budget(**saved.training["budget"]))
        if record is None:
            record = of_saved
        elif replace(record, budget=of_saved.budget, finished=False) == of_saved:
            record = replace(record, finished=False)
        else:
            saved = None
    assert record is not None
    if record.clip != clip.digest():
        name = (
            ""
            if saved is None
            else (f" ({saved.clip.name}, {saved.clip.num_frames} frames of {saved.clip.width}x{saved.clip.height})")
        )
        raise CheckpointError(f"{folder} was fitted to another clip{name}; give that clip, or another --out")
    return saved, record


@contextmanager
def _recorded(record: Record, folder: Path) -> Iterator[None]:
    """Keeps `run.json` and `config.yaml` from here on; where the block fails, the folder is as it was."""
    files = [folder / name for name in (RECORD, "config.yaml")]
    former = [file.read_bytes() if file.is_file() else None for file in files]
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        record.write(folder)
        with replacing(files[1]) as file:
            file.write_text(yaml.safe_dump(record.config.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
        yield
    except Exception:
        for file, content in zip(files, former, strict=True):
            file.unlink(missing_ok=True) if content is None else file.write_bytes(content)
        for each in made:
            with suppress(OSError):  # something is in it
                each.rmdir()
        raise


def _begun(folder: Path, clip: Clip, record: Record, pool: Pool, device: torch.device) -> Run:
    """A run at its first step, in a folder of which all that was of a former run is gone."""
    config = record.config
    for former in ("previews", "tensorboard"):
        shutil.rmtree(folder / former, ignore_errors=True)
    for file in (windows.FILE_NAME, CORRECTIONS):
        (folder / file).unlink(missing_ok=True)
    starts = (start_maps(config.model.static.start, pool), start_maps(config.model.dynamic.start, pool))
    with first_weights(record.seed):
        model = DecoMotion(config.model, ImagePlane(clip.height, clip.width), starts, pool.feature_size)
    return Run(folder, ClipFacts.of(clip), config, model.to(device), pool, record.seed)


def _resumed(folder: Path, saved: Checkpoint, pool: Pool) -> Run:
    """The run in `folder` as its checkpoint has it."""
    seed = saved.training["seed"]
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
