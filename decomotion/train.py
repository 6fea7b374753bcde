"""Fits a model to a clip: what a run begins with, or where it goes on."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
import yaml

from decomotion import checkpoint, losses, rigid, shots
from decomotion.checkpoint import ClipFacts
from decomotion.clip import Clip, read_clip
from decomotion.config import Config
from decomotion.config import load as load_config
from decomotion.data.pool import Pool
from decomotion.data.prepare import affordable, prepare_in_stages
from decomotion.errors import CheckpointError, ConfigError
from decomotion.files import replacing
from decomotion.geometry import ImagePlane
from decomotion.model.fusion import DecoMotion
from decomotion.run import Run
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
) -> Path:
    """Fits one model to one clip.

    Args:
        clip: a clip, or the path of one (`decomotion.clip.read_clip`).
        out: the run's folder; default `runs/<clip name>`.
        config: the configuration; default: the `cpu` preset, or `paper` where there is a CUDA device.
        steps: number of optimisation steps; default: the configuration's.
        time_budget: seconds that the whole call may take; the schedules are fitted to it, and a short one thins the
            gaps at which flow is computed (`decomotion.data.prepare.affordable`). Excludes `steps`.
        resume: continue the run in `out`, with its own configuration and seed, and its budget where none is given.
        rebuild_cache: prepare the supervision anew.
        seed: seed of everything random.
        device: `auto`, `cpu`, `cuda` or any name torch knows.
        progress: show a progress bar.
        ignore_cuts: fit the clip even where it cuts from one shot to another.

    Returns: the run's folder, which holds `checkpoint.pt`, `config.yaml`, TensorBoard logs and previews.

    Raises: `ClipError` where the clip cannot be read or has cuts, `SupervisionError`, `CheckpointError`;
        `TrainingError` where a loss is not a number.
    """
    begin = time.monotonic()
    clip = clip if isinstance(clip, Clip) else read_clip(clip)
    folder = Path(out) if out is not None else Path("runs") / clip.name
    where = torch.device(choose_device(device))
    if resume:
        run = _resumed(folder, clip, where, steps, time_budget, progress)
    else:
        config = config or load_config("paper" if where.type == "cuda" else "cpu")
        losses.check(config.loss, config.model.volumes)
        if not ignore_cuts:
            shots.check_one_shot(clip)
        budget = Budget(steps or config.optim.steps, time_budget)
        run = _fresh(folder, clip, config, where, seed, budget, begin, rebuild_cache, progress)
    with _says_how_to_resume(folder):
        run.loop(begin, progress)
    return folder


def choose_device(name: str) -> str:
    """The device that `name` means; `auto` is CUDA where there is one."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.device(name)
    except RuntimeError as error:
        raise ConfigError(f"--device {name} is not a device that torch knows; use auto, cpu or cuda") from error
    if name.startswith("cuda") and not torch.cuda.is_available():
        raise ConfigError("--device cuda was asked for but torch sees no CUDA device; use --device cpu or auto")
    try:
        usable = torch.empty(0, device=name).device.type != "meta"
    except (AssertionError, RuntimeError):
        usable = False
    if not usable:
        raise ConfigError(f"--device {name} cannot be computed on here; use auto, cpu or cuda")
    return name


def _fresh(
    folder: Path,
    clip: Clip,
    config: Config,
    device: torch.device,
    seed: int,
    budget: Budget,
    begin: float,
    rebuild: bool,
    progress: bool,
) -> Run:
    if budget.seconds is not None:
        data = affordable(clip, config.data, budget.seconds, rebuild=rebuild)
        config = config.model_copy(update={"data": data})  # in the run's own, so that it finds these links again
    prepared = prepare_in_stages(clip, config.data, rebuild=rebuild, progress=progress, device=str(device))
    pool, facts = prepared.pool, ClipFacts.of(clip)
    for former in ("previews", "tensorboard", rigid.FOLDER):
        shutil.rmtree(folder / former, ignore_errors=True)
    (folder / shots.FILE_NAME).unlink(missing_ok=True)
    with replacing(folder / "config.yaml") as file:
        file.write_text(yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
    run = Run(folder, facts, config, _model(config, clip, pool, device, seed), pool, seed)
    run.budget = budget
    if config.data.masks != rigid.RIGID_FIRST:
        return run
    run.elapsed = time.monotonic() - begin
    run.save()  # not yet prepared, which is how --resume knows that the static volume comes first
    return _rigid_stage(run, clip, prepared.grid, progress)


def _rigid_stage(run: Run, clip: Clip, grid: tuple[int, int], progress: bool) -> Run:
    """Fits the static volume alone, or goes on where that was interrupted.

    Returns the run that follows, with what is left of the steps; `elapsed` is what the stage had taken before.
    """
    folder, config = run.folder / rigid.FOLDER, rigid.rigid_config(run.config)
    first = Run(folder, run.clip, config, _model(config, clip, run.pool, run.device, run.seed), run.pool, run.seed)
    if (folder / checkpoint.FILE_NAME).is_file():
        saved = checkpoint.load(folder / checkpoint.FILE_NAME, run.device)
        first.model.load_state_dict(saved.model.state_dict())
        first.restore(saved.training)
    first.budget = run.budget.part(rigid.SHARE, run.elapsed)
    before = first.elapsed
    with _says_how_to_resume(run.folder):
        first.loop(time.monotonic(), progress)
    pool = rigid.seeded(run.pool, clip, grid, first.model)
    rigid.save_motion(run.folder, pool)
    model = _model(run.config, clip, pool, run.device, run.seed)
    model.load_state_dict(first.model.state_dict(), strict=False)  # the static volume goes on from there
    begun = Run(run.folder, run.clip, run.config, model, pool, run.seed)
    begun.budget, begun.elapsed = run.budget.after(first.step), before
    return begun


def _model(config: Config, clip: Clip, pool: Pool, device: torch.device, seed: int) -> DecoMotion:
    """A model as it is before its fit."""
    torch.manual_seed(seed)
    plane = ImagePlane(clip.height, clip.width)
    starts = (start_maps(config.model.static.start, pool), start_maps(config.model.dynamic.start, pool))
    return DecoMotion(config.model, plane, starts, pool.feature_size).to(device)


def _resumed(
    folder: Path, clip: Clip, device: torch.device, steps: int | None, time_budget: float | None, progress: bool
) -> Run:
    saved = checkpoint.load(folder / checkpoint.FILE_NAME, device)
    if saved.clip.digest != clip.digest():
        raise CheckpointError(
            f"{folder} was fitted to another clip ({saved.clip.name}, {saved.clip.num_frames} frames of "
            f"{saved.clip.width}x{saved.clip.height}); give that clip, or another --out"
        )
    prepared = prepare_in_stages(clip, saved.config.data, device=str(device))
    rigid_first, seed = saved.config.data.masks == rigid.RIGID_FIRST, saved.training["seed"]
    in_rigid_stage = rigid_first and not saved.training["prepared"]
    pool = rigid.load_motion(folder, prepared.pool) if rigid_first and not in_rigid_stage else prepared.pool
    run = Run(folder, saved.clip, saved.config, saved.model, pool, seed)
    run.restore(saved.training)
    if steps is not None or time_budget is not None:
        run.budget = Budget(steps or saved.config.optim.steps, time_budget)
        if rigid_first and not in_rigid_stage:
            run.budget = run.budget.after(
                checkpoint.load(folder / rigid.FOLDER / checkpoint.FILE_NAME).training["step"]
            )
    if not in_rigid_stage:
        return run
    begun = _rigid_stage(run, clip, prepared.grid, progress)
    begun.elapsed += run.elapsed
    return begun


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
