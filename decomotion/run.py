"""One optimisation: draw pairs -> predict -> losses -> step -> log; where it is saved and how it goes on."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from tqdm import tqdm

from decomotion import checkpoint, held_out, images, previews, quality
from decomotion.chance import torch_generator
from decomotion.checkpoint import ClipFacts
from decomotion.config import Config
from decomotion.data.batch import Batch, Sampler
from decomotion.data.pool import Pool
from decomotion.errors import CheckpointError, TrainingError
from decomotion.files import naming, replacing
from decomotion.gradient import Accumulator
from decomotion.held_out import Contradicts, HeldOut
from decomotion.losses import applicable
from decomotion.model.fusion import DecoMotion
from decomotion.model.precision import set_precision
from decomotion.quality import ENOUGH_STEPS, Quality
from decomotion.schedule import Budget, learning_rate_factor, longest_gap, value_at
from decomotion.windows import whole_of

log = logging.getLogger(__name__)

LONGER = 10
"""Times the given time that a starved fit is advised to take at most, for `ENOUGH_STEPS`."""


Stopping = Callable[[], AbstractContextManager[Event]]
"""Within it steps are taken until the event is set, whoever sets it: `decomotion.console.interrupt_flag` on Ctrl-C."""


def never() -> AbstractContextManager[Event]:
    """Nobody tells a run to stop."""
    return nullcontext(Event())


@dataclass(frozen=True)
class Lesson:
    """What a model that was fitted before is to learn besides."""

    pool: Pool
    """From which batches are drawn, in place of the pool that the model was fitted to."""
    frame_weights: npt.NDArray[np.floating]
    """[frame]: how often from each."""
    contradicts: Contradicts
    """Tells links of that former pool that it is not to be judged by."""
    steps: int
    """That the model took before."""


class Run:
    """One optimisation: model, optimiser and sampler, and where they are saved.

    Args:
        folder: where.
        clip: facts of the clip.
        config: the configuration.
        model: the model, on its device.
        pool: the clip's links.
        seed: of everything random.
        lesson: what a finished model is to learn; None: the links.
    """

    def __init__(
        self,
        folder: Path,
        clip: ClipFacts,
        config: Config,
        model: DecoMotion,
        pool: Pool,
        seed: int,
        lesson: Lesson | None = None,
    ) -> None:
        self.folder, self.clip, self.config, self.model, self.pool, self.seed = folder, clip, config, model, pool, seed
        self.lesson = lesson
        self.held_out = HeldOut(pool, seed)
        if lesson is None:
            self.sampler = Sampler(pool, config.optim, self.held_out.links)
        else:
            self.sampler = Sampler(lesson.pool, config.optim, frame_weights=lesson.frame_weights)
        set_precision(model, config.optim.autocast)
        self.optimiser = torch.optim.Adam(_parameter_groups(model, config))
        self.losses = applicable(config.loss, config.model.volumes)
        self.budget = Budget(config.optim.steps)
        self.step = 0
        self.elapsed = 0.0
        """Wall time in seconds that the run has taken, its preparation included."""
        self.prepared = 0.0
        """Seconds of it that the preparation took."""
        self.quality: Quality | None = None
        """How good the fit is: measured at its end."""
        self.gradient = Accumulator(model, config.optim.smooth_share)

    def restore(self, training: dict[str, Any]) -> None:
        """Continues where `training`, written by `save`, was.

        Links that were made anew, in more time or less, may be of other points: how well each was fitted is then
        learnt again. Raises `CheckpointError` where there are other tracks.
        """
        points, former = self.sampler.errors.shape[1], training["errors"].shape[1]
        if points == former:
            self.sampler.errors.copy_(training["errors"])
        elif self.config.data.tracks is not None:
            raise CheckpointError(
                f"{self.folder} was fitted to {former} points a frame but its supervision now has {points}: its tracks "
                "are others, or its links were made anew in less or more time; give the tracks that it was begun with, "
                "or train again without --resume"
            )
        self.optimiser.load_state_dict(training["optimiser"])
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
        file = self.folder / checkpoint.FILE_NAME
        checkpoint.save(file, self.config, self.clip, self.model, training, self.pool.thinned, self.quality)

    def loop(self, begin: float, progress: bool, stopping: Stopping = never) -> None:
        """Optimises until the budget is spent; saves on the way, when it is told to stop and at the end.

        Raises `KeyboardInterrupt` where it was told to stop.
        """
        from torch.utils.tensorboard import SummaryWriter

        begin -= self.elapsed
        if not self.step:
            self.prepared = self.elapsed = time.monotonic() - begin
            self.save()  # from here on --resume finds this run, not a former one in the same folder
        (self.folder / quality.FILE_NAME).unlink(missing_ok=True)  # a former end's
        events = self.folder / "tensorboard"
        with naming(events):
            writer = SummaryWriter(str(events), purge_step=self.step)
        saved = shown = time.monotonic()
        pictures = int(self.progress * self.config.log.previews)
        bar = tqdm(total=100, desc="fit", disable=not progress, bar_format="{desc} {percentage:3.0f}%|{bar}| {postfix}")
        with stopping() as told, naming(events), closing(writer), closing(bar):
            while (done := self.progress) < 1 and not told.is_set():
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
            if done >= 1:
                self.judge(writer)
            self.save()
        if done < 1:
            log.info("stopped at step %d", self.step)
            raise KeyboardInterrupt
        self.preview(None)
        self.tell()

    @property
    def progress(self) -> float:
        """Fraction of the optimisation that is done."""
        return self.budget.progress(self.step, self.elapsed, self.prepared)

    def optimise(self, progress: float) -> dict[str, float]:
        """One step; returns the unweighted losses."""
        optim = self.config.optim
        batch = self.sampler.draw(longest_gap(optim, progress, self.pool.num_frames), self._chance("batch"))
        offset = torch.rand((*batch.xy.shape[:2], self.config.model.samples), generator=self._chance("depths"))
        weights = {name: now for name, weight in self.losses.items() if (now := value_at(weight, progress)) > 0}
        factor = learning_rate_factor(optim, progress)
        for group in self.optimiser.param_groups:
            group["lr"] = group["base_lr"] * factor

        self.optimiser.zero_grad(set_to_none=not self.gradient.recorded)  # what is recorded keeps its places
        losses, errors = [], []
        for part, its_offset in self._parts(batch, offset):
            share = len(part.frame) / optim.pairs
            terms = self.gradient.add(part, its_offset, {name: share * weight for name, weight in weights.items()})
            losses.append(share * terms.losses)
            errors.append(terms.error)
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), optim.clip_norm)
        *values, norm = torch.cat([torch.stack(losses).sum(0), norm[None]]).tolist()  # the step's one wait for a GPU
        for what, value in [*zip((f"loss {name}" for name in weights), values, strict=True), ("the gradient", norm)]:
            if not math.isfinite(value):  # before it poisons the weights
                raise TrainingError(self._failure(what, batch))
        self.optimiser.step()
        self.sampler.note_errors(batch, torch.cat(errors).cpu())
        return dict.fromkeys(self.losses, 0.0) | dict(zip(weights, values, strict=True))

    def _chance(self, purpose: str) -> torch.Generator:
        """This step's; it draws on the CPU, so that it draws the same whatever the device."""
        return torch_generator(self.seed, purpose, self.step)

    def _parts(self, batch: Batch, offset: torch.Tensor) -> Iterator[tuple[Batch, torch.Tensor]]:
        size = self.config.optim.micro_batch or self.config.optim.pairs
        for first in range(0, self.config.optim.pairs, size):
            yield batch.pairs(first, first + size), offset[first : first + size]

    def _failure(self, what: str, batch: Batch) -> str:
        path = self.folder / "failed_batch.pt"
        checkpoint.write(path, batch.__dict__)
        return (
            f"{what} is not a number at step {self.step}; the batch is in {path}; "
            "lower the learning rates (--set optim.lr_transform=…) or look at the clip's supervision"
        )

    def preview(self, writer: Any) -> None:
        """Writes a picture of the clip's middle frame, layer by layer."""
        picture = previews.render_layers(self.model, self.pool.num_frames // 2)
        with replacing(self.folder / "previews" / f"{self.step:06d}.png") as file:
            file.write_bytes(images.png(picture))
        if writer is not None:
            writer.add_image("layers", picture, self.step, dataformats="HWC")

    def judge(self, writer: Any) -> None:
        """Measures how good the fit is on the links that were held out of it; from here on no step follows."""
        set_precision(self.model, "none")  # as an exported file answers
        contradicts, before = (None, 0) if self.lesson is None else (self.lesson.contradicts, self.lesson.steps)
        links = (self.pool, self.held_out, contradicts)
        self.quality = held_out.measure(self.model, *links, seed=self.seed, steps=before + self.step)
        if self.quality is not None:
            with replacing(self.folder / quality.FILE_NAME) as file:
                file.write_text(self.quality.as_json(), encoding="utf-8")
            for name, figures in self.quality.rows():
                writer.add_scalar(f"held_out/{name.replace(' ', '_')}", figures.median, self.step)

    def tell(self) -> None:
        """Says how good the fit is and, where it is starved, what to do."""
        if self.quality is None:
            log.warning("no link was held out of the fit whose target is known: nothing tells how good it is")
            return
        log.info("%s\n%s", self.quality.summary(), self.quality.table())
        if self.lesson is None and (warning := self.quality.warning()):
            log.warning("%s. %s", warning, self.remedy())

    def remedy(self) -> str:
        """What to do about a starved fit, a sentence of its own."""
        steps, (folder, windows) = max(2 * self.step, ENOUGH_STEPS), whole_of(self.folder)
        more = f"--steps {steps}"
        if (given := self.budget.seconds) is not None:
            wanted = self.prepared + steps * (self.elapsed - self.prepared) / self.step
            more = f"--time-budget {math.ceil(windows * min(max(2 * given, wanted), LONGER * given) / 60)}m"
        if self.pool.thinned is None:
            return f"Go on with decomo-train on the same clip with --resume --out {folder} {more}"
        return f"Fit the clip anew with a longer --prepare-budget and {more}, since --resume keeps the links"


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
