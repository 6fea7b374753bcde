"""The fit: sample pairs -> predict -> losses -> step -> log."""

from __future__ import annotations

import logging
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Event, current_thread, main_thread
from typing import Any

import torch
import yaml
from tqdm import tqdm

from decomotion import checkpoint, previews, rigid
from decomotion.checkpoint import ClipFacts
from decomotion.clip import Clip, read_clip
from decomotion.config import Config
from decomotion.config import load as load_config
from decomotion.data.batch import Batch, Sampler
from decomotion.data.pool import Pool
from decomotion.data.prepare import prepare_in_stages
from decomotion.errors import CheckpointError, ConfigError, TrainingError
from decomotion.files import replacing
from decomotion.geometry import ImagePlane
from decomotion.losses import LOSSES, applicable, check_names
from decomotion.model.fusion import DecoMotion
from decomotion.model.precision import set_precision
from decomotion.schedule import learning_rate_factor, longest_gap, value_at
from decomotion.shots import check_one_shot

log = logging.getLogger(__name__)


MOST_OF_IT = 0.6
"""Share of a run's time from which preparation is worth a warning."""
MIN_SECONDS = 1.0
"""A run optimises for this long even where preparation has used up its time."""


@dataclass(frozen=True)
class Budget:
    """When a run is over: after `steps`, or after `seconds` of wall time, preparation included."""

    steps: int
    seconds: float | None = None

    def progress(self, step: int, elapsed: float, prepared: float) -> float:
        """Fraction of the optimisation that is done, `prepared` seconds of `elapsed` having gone to preparation."""
        if self.seconds is None:
            return step / self.steps
        return min(1.0, (elapsed - prepared) / max(self.seconds - prepared, MIN_SECONDS))

    def part(self, share: float, elapsed: float) -> Budget:
        """That share of the steps, or of the time that is left after `elapsed` seconds."""
        seconds = None if self.seconds is None else share * max(self.seconds - elapsed, MIN_SECONDS)
        return Budget(max(1, round(share * self.steps)), seconds)


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
        time_budget: seconds that the whole call may take; the schedules are fitted to it. Excludes `steps`.
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
        run = _resumed(folder, clip, where, progress)
    else:
        config = config or load_config("paper" if where.type == "cuda" else "cpu")
        check_names(config.loss)
        if not ignore_cuts:
            check_one_shot(clip)
        budget = Budget(steps or config.optim.steps, time_budget)
        run = _fresh(folder, clip, config, where, seed, budget, begin, rebuild_cache, progress)
    if steps is not None or time_budget is not None:
        run.budget = Budget(steps or run.config.optim.steps, time_budget)
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
    prepared = prepare_in_stages(clip, config.data, rebuild=rebuild, progress=progress, device=str(device))
    pool, facts = prepared.pool, ClipFacts.of(clip)
    for former in ("previews", "tensorboard", rigid.FOLDER):
        shutil.rmtree(folder / former, ignore_errors=True)
    with replacing(folder / "config.yaml") as file:
        file.write_text(yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
    run = Run(folder, facts, config, _model(config, clip, pool, device, seed), pool, seed)
    if config.data.masks != rigid.RIGID_FIRST:
        return run
    run.budget, run.elapsed = budget, time.monotonic() - begin
    run.save()  # not yet prepared, which is how --resume knows that the static volume comes first
    pool, model, _ = _rigid_stage(run, clip, prepared.grid, progress)
    return Run(folder, facts, config, model, pool, seed)


def _rigid_stage(run: Run, clip: Clip, grid: tuple[int, int], progress: bool) -> tuple[Pool, DecoMotion, float]:
    """Fits the static volume alone, or goes on where that was interrupted.

    Returns the pool and the model with which `run` begins, and the seconds that the stage had taken before.
    """
    folder, config = run.folder / rigid.FOLDER, rigid.rigid_config(run.config)
    first = Run(folder, run.clip, config, _model(config, clip, run.pool, run.device, run.seed), run.pool, run.seed)
    first.budget = run.budget.part(rigid.SHARE, run.elapsed)
    if (folder / checkpoint.FILE_NAME).is_file():
        saved = checkpoint.load(folder / checkpoint.FILE_NAME, run.device)
        first.model.load_state_dict(saved.model.state_dict())
        first.restore(saved.training)
    before = first.elapsed
    with _says_how_to_resume(run.folder):
        first.loop(time.monotonic(), progress)
    pool = rigid.seeded(run.pool, clip, grid, first.model)
    rigid.save_motion(run.folder, pool)
    model = _model(run.config, clip, pool, run.device, run.seed)
    model.load_state_dict(first.model.state_dict(), strict=False)  # the static volume goes on from there
    return pool, model, before


def _model(config: Config, clip: Clip, pool: Pool, device: torch.device, seed: int) -> DecoMotion:
    """A model as it is before its fit."""
    torch.manual_seed(seed)
    plane = ImagePlane(clip.height, clip.width)
    starts = (start_maps(config.model.static.start, pool), start_maps(config.model.dynamic.start, pool))
    return DecoMotion(config.model, plane, starts, pool.feature_size).to(device)


def _resumed(folder: Path, clip: Clip, device: torch.device, progress: bool) -> Run:
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
    if not in_rigid_stage:
        return run
    pool, model, before = _rigid_stage(run, clip, prepared.grid, progress)
    begun = Run(folder, saved.clip, saved.config, model, pool, seed)
    begun.budget, begun.elapsed = run.budget, run.elapsed + before
    return begun


def start_maps(kind: str, pool: Pool) -> torch.Tensor:
    """Affine maps from local to canonical space that a volume starts with, [frame, 3, 4]."""
    maps = torch.eye(3, 4).repeat(pool.num_frames, 1, 1)
    if kind != "identity":
        planar = torch.from_numpy((pool.camera if kind == "camera" else pool.object).copy())
        maps[:, :2, :2] = planar[..., :2]
        maps[:, :2, 3] = planar[..., 2]
    return maps


class Run:
    """One optimisation: model, optimiser and sampler, and where they are saved."""

    def __init__(self, folder: Path, clip: ClipFacts, config: Config, model: DecoMotion, pool: Pool, seed: int) -> None:
        self.folder, self.clip, self.config, self.model, self.pool, self.seed = folder, clip, config, model, pool, seed
        self.sampler = Sampler(pool, config.optim)
        set_precision(model, config.optim.autocast)
        self.optimiser = torch.optim.Adam(_parameter_groups(model, config))
        self.losses = applicable(config.loss, config.model.volumes)
        self.budget = Budget(config.optim.steps)
        self.step = 0
        self.elapsed = 0.0
        """Wall time in seconds that the run has taken, its preparation included."""
        self.prepared = 0.0
        """Seconds of it that the preparation took."""
        self.device = next(model.parameters()).device

    def restore(self, training: dict[str, Any]) -> None:
        """Continues where `training`, written by `save`, was."""
        self.optimiser.load_state_dict(training["optimiser"])
        self.sampler.errors.copy_(training["errors"])
        self.step, self.elapsed, self.prepared = training["step"], training["elapsed"], training["prepared"]
        self.budget = Budget(**training["budget"])

    def save(self) -> None:
        """Writes the checkpoint."""
        training = {
            "optimiser": self.optimiser.state_dict(),
            "errors": self.sampler.errors,
            "step": self.step,
            "elapsed": self.elapsed,
            "prepared": self.prepared,
            "seed": self.seed,
            "budget": asdict(self.budget),
        }
        checkpoint.save(self.folder / checkpoint.FILE_NAME, self.config, self.clip, self.model, training)

    def loop(self, begin: float, progress: bool) -> None:
        """Optimises until the budget is spent; saves on the way, on Ctrl-C and at the end."""
        from torch.utils.tensorboard import SummaryWriter

        begin -= self.elapsed
        if not self.step:
            self.prepared = self.elapsed = time.monotonic() - begin
            self.save()  # from here on --resume finds this run, not a former one in the same folder
            if self.budget.seconds and self.prepared > MOST_OF_IT * self.budget.seconds:
                log.warning(
                    "preparation took %d of the %d seconds: expect a poor fit; give a longer --time-budget",
                    self.prepared,
                    self.budget.seconds,
                )
        writer = SummaryWriter(str(self.folder / "tensorboard"), purge_step=self.step)
        saved = shown = time.monotonic()
        pictures = int(self.progress * self.config.log.previews)
        bar = tqdm(total=100, desc="fit", disable=not progress, bar_format="{desc} {percentage:3.0f}%|{bar}| {postfix}")
        with interrupt_flag() as interrupted, closing(writer), closing(bar):
            while (done := self.progress) < 1 and not interrupted.is_set():
                losses = self.optimise(done)
                self.step += 1
                now = time.monotonic()
                self.elapsed = now - begin
                if self.step % self.config.log.scalars_every == 0:
                    for name, value in losses.items():
                        writer.add_scalar(f"loss/{name}", value, self.step)
                if now - shown > 1:
                    shown = now
                    _show(bar, self, losses)
                if done * self.config.log.previews >= pictures + 1:
                    pictures += 1
                    self.preview(writer)
                if now - saved > self.config.log.checkpoint_seconds:
                    self.save()
                    saved = time.monotonic()
            self.save()
        if done < 1:
            log.info("stopped at step %d", self.step)
            raise KeyboardInterrupt
        self.preview(None)

    @property
    def progress(self) -> float:
        """Fraction of the optimisation that is done."""
        return self.budget.progress(self.step, self.elapsed, self.prepared)

    def optimise(self, progress: float) -> dict[str, float]:
        """One step; returns the unweighted losses."""
        optim = self.config.optim
        generator = torch.Generator().manual_seed((self.seed << 32) + self.step)
        batch = self.sampler.draw(longest_gap(optim, progress, self.pool.num_frames), generator)
        depth_generator = torch.Generator(self.device).manual_seed((self.seed << 32) + (1 << 31) + self.step)
        weights = {name: value_at(weight, progress) for name, weight in self.losses.items()}
        factor = learning_rate_factor(optim, progress)
        for group in self.optimiser.param_groups:
            group["lr"] = group["base_lr"] * factor

        self.optimiser.zero_grad(set_to_none=True)
        totals = dict.fromkeys(weights, 0.0)
        size = optim.micro_batch or optim.pairs
        for first in range(0, optim.pairs, size):
            part = batch.pairs(first, first + size)
            share = len(part.frame) / optim.pairs
            values = self.accumulate(part, weights, share, depth_generator)
            for name, value in values.items():
                totals[name] += share * value
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), optim.clip_norm)
        if not norm.isfinite():  # before it poisons the weights
            raise TrainingError(self._failure("the gradient", batch))
        self.optimiser.step()
        return totals

    def accumulate(
        self, batch: Batch, weights: dict[str, float], share: float, generator: torch.Generator
    ) -> dict[str, float]:
        """Adds the gradients of one part of a batch, which makes up `share` of it; returns its losses."""
        on_device = batch.to(self.device)
        smooth_points = round(self.config.optim.smooth_share * on_device.xy.shape[1])
        prediction = self.model.predict(on_device.xy, on_device.frame, on_device.target_frame, generator, smooth_points)
        losses = {name: LOSSES[name](prediction, on_device) for name, weight in weights.items() if weight > 0}
        values = {name: float(loss.detach()) for name, loss in losses.items()}
        for name, value in values.items():
            if value != value or value in (float("inf"), float("-inf")):
                raise TrainingError(self._failure(f"loss {name}", batch))
        sum(share * weights[name] * loss for name, loss in losses.items()).backward()  # type: ignore[union-attr]
        with torch.no_grad():
            error = (prediction.fused_xy - on_device.target_xy).norm(dim=-1)
        self.sampler.note_errors(batch, error.cpu())
        return values

    def _failure(self, what: str, batch: Batch) -> str:
        path = self.folder / "failed_batch.pt"
        with replacing(path) as temporary:
            torch.save(batch.__dict__, temporary)
        return (
            f"{what} is not a number at step {self.step}; the batch is in {path}; "
            "lower the learning rates (--set optim.lr_transform=…) or look at the clip's supervision"
        )

    def preview(self, writer: Any) -> None:
        """Writes a picture of the clip's middle frame, layer by layer."""
        picture = previews.render_layers(self.model, self.pool.num_frames // 2)
        with replacing(self.folder / "previews" / f"{self.step:06d}.png") as file:
            file.write_bytes(previews.to_png(picture))
        if writer is not None:
            writer.add_image("layers", picture, self.step, dataformats="HWC")


def _parameter_groups(model: DecoMotion, config: Config) -> list[dict[str, Any]]:
    groups: dict[str, list[torch.nn.Parameter]] = {"lr_field": [], "lr_transform": [], "lr_code": []}
    for name, parameter in model.named_parameters():
        if name.startswith("frame_code."):
            groups["lr_code"].append(parameter)
        elif ".affine." in name or ".couplings." in name:
            groups["lr_transform"].append(parameter)
        else:
            groups["lr_field"].append(parameter)
    return [
        {"params": parameters, "lr": getattr(config.optim, key), "base_lr": getattr(config.optim, key)}
        for key, parameters in groups.items()
    ]


def _show(bar: Any, run: Run, losses: dict[str, float]) -> None:
    bar.n = round(100 * run.progress)
    optimising = run.elapsed - run.prepared
    left = optimising / max(run.progress, 1e-6) - optimising
    shown = "  ".join(f"{name} {value:.2f}" for name, value in losses.items() if name.startswith("flow"))
    bar.set_postfix_str(f"step {run.step}  {run.step / optimising:.1f}/s  {left / 60:.1f} min left  {shown}")


@contextmanager
def _says_how_to_resume(folder: Path) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        log.info("decomo-train on the same clip with --resume --out %s goes on", folder)
        raise


@contextmanager
def interrupt_flag() -> Iterator[Event]:
    """An event that the first Ctrl-C sets, so that a step is never cut in two; a second Ctrl-C interrupts at once."""
    event = Event()
    if current_thread() is not main_thread():
        yield event
        return
    former = signal.getsignal(signal.SIGINT)

    def note(*_: object) -> None:
        event.set()
        signal.signal(signal.SIGINT, former)

    signal.signal(signal.SIGINT, note)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, former)
