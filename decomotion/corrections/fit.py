"""A new run from a finished one and corrections: a short fit, which goes on from its weights."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
import yaml

from decomotion import checkpoint
from decomotion.chance import generator
from decomotion.checkpoint import Checkpoint
from decomotion.clip import Clip
from decomotion.config import Config
from decomotion.corrections.following import HIDDEN, follow
from decomotion.corrections.lesson import lesson_pool
from decomotion.corrections.points import CorrectedPoint, Place
from decomotion.corrections.seams import in_windows
from decomotion.corrections.trusted import Bent, contradiction, trusted_tracks
from decomotion.data.prepare import prepare_in_stages
from decomotion.device import choose_device
from decomotion.errors import CheckpointError
from decomotion.files import new_folder, replacing
from decomotion.long_clip import read_windows
from decomotion.model.fusion import DecoMotion
from decomotion.record import CORRECTIONS, Record, read_record
from decomotion.run import Lesson, Run, Stopping, never
from decomotion.schedule import Budget, Schedule, value_at
from decomotion.windows import FILE_NAME, Window, Windows

log = logging.getLogger(__name__)

WARM_UP = 0.05
"""Of the short fit."""
CONTRADICTS = 0.5
"""From this on a held-out link contradicts the corrections, and the fit is not judged by it."""


def correct(
    clip: Clip,
    run: Path,
    corrections: Path,
    points: Sequence[CorrectedPoint],
    out: Path,
    *,
    budget: Budget,
    device: str = "auto",
    progress: bool = True,
    stopping: Stopping = never,
) -> Path:
    """Fits a finished run's model anew, so that it agrees with corrections.

    Of a run of several windows, those that have something to learn, one after the other; the others are copied.

    Args:
        clip: the clip that the run was fitted to.
        run: folder of the finished run, which stays as it is.
        corrections: the file that `points` were read from (`decomotion.corrections.file`), which is copied.
        points: at least one.
        out: the new run's folder, which is there when it is finished, and only then.
        budget: steps of each window; or seconds of the whole call, but for preparation, which windows share by their
            length.
        device: `auto`, `cpu`, `cuda` or any name torch knows.
        progress: show a progress bar.
        stopping: says when to stop between two steps; then nothing is left.

    Returns: `out`.

    Raises: `CheckpointError` where the run is not finished or is another clip's, `CorrectionError` where a point is
        corrected across a cut, `TrainingError` where a loss is not a number, `KeyboardInterrupt` where it was told to
        stop.
    """
    begin = time.monotonic()
    where = torch.device(choose_device(device))
    layout = _layout(run, clip)
    saved = {number: _finished(run / window.name, where) for number, window in enumerate(layout.windows)}

    def track(number: int, place: Place) -> npt.NDArray[np.float32]:
        return follow(saved[number].model, np.array([place])).xy[0]

    taught = in_windows(points, layout, track)
    frames = sum(len(layout.windows[number]) for number in taught)
    with new_folder(out) as folder:
        if layout.windows[0].name:
            shutil.copyfile(run / FILE_NAME, folder / FILE_NAME)
        for number, window in enumerate(layout.windows):
            if number not in taught:
                shutil.copytree(run / window.name, folder / window.name)
                continue
            part = clip if not window.name else clip.part(window.begin, window.end, window.name)
            seconds = budget.seconds
            if seconds is not None and window.name:
                seconds *= len(window) / frames
                begin = time.monotonic()
            each = Budget(budget.steps, seconds)
            if window.name:
                log.info("%s, frames %d:%d", window.name, window.begin, window.end)
            how = (each, begin, where, progress, stopping)
            _correct_one(part, saved[number], taught[number], folder / window.name, *how)
            shutil.copyfile(corrections, folder / window.name / CORRECTIONS)
        if layout.windows[0].name:
            shutil.copyfile(corrections, folder / CORRECTIONS)
    return out


def _layout(run: Path, clip: Clip) -> Windows:
    """The windows of a run; of one that has none, one without a name."""
    if (run / FILE_NAME).is_file():
        layout, digest, _ = read_windows(run)
    else:
        record = read_record(run)
        if record is None:
            raise CheckpointError(f"{run} holds no run; give --run the folder of a finished fit")
        digest = record.clip
        layout = Windows(clip.name, len(clip), clip.height, clip.width, clip.fps, (Window("", 0, len(clip)),))
    if digest != clip.digest():
        raise CheckpointError(f"{run} was fitted to another clip than {clip.name}; give that clip, or its own run")
    return layout


def _finished(folder: Path, device: torch.device) -> Checkpoint:
    record = read_record(folder)
    if record is None or not record.finished:
        raise CheckpointError(f"{folder} is not finished; finish it with decomo-train --resume, then correct it")
    return checkpoint.load(folder / checkpoint.FILE_NAME, device)


def _correct_one(
    clip: Clip,
    saved: Checkpoint,
    points: Sequence[CorrectedPoint],
    folder: Path,
    budget: Budget,
    begin: float,
    device: torch.device,
    progress: bool,
    stopping: Stopping,
) -> None:
    model, seed, config = saved.model, saved.training["seed"], short(saved.config)
    tracks = trusted_tracks(model, points)
    before = _apart(model, points)
    waited = time.monotonic()
    prepared = prepare_in_stages(clip, config.data, seed=seed, progress=progress, device=str(device))
    begin += time.monotonic() - waited  # long only where the cache has lost it
    links = lesson_pool(model, prepared, clip.frames, tracks, generator(seed, "corrections"))
    contradicts = partial(_contradicts, tracks.bent, model.plane.unit)
    steps = saved.training["step"] if saved.quality is None else saved.quality.steps
    run = Run(
        folder,
        saved.clip,
        config,
        model,
        prepared.pool,
        seed,
        Lesson(links, _frame_weights(points, len(clip)), contradicts, steps),
    )
    run.budget = budget
    record = Record(saved.clip.digest, config, seed, budget)
    record.write(folder)
    with replacing(folder / "config.yaml") as file:
        file.write_text(yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
    run.loop(begin, progress, stopping)
    record.finish(folder)
    log.info("%s", _told(points, before, _apart(model, points)))


def short(config: Config) -> Config:
    """The configuration of a short fit: of the links none is wrong, and gaps of any length are learned from the start.

    That of a run that was corrected before stays as it is.
    """
    optim = config.optim.model_copy(
        update={"gap": Schedule(value=1, to=1, begin=0, end=1), "warmup": WARM_UP, "decay": "cosine"}
    )
    loss = {name: value_at(weight, 0.0) for name, weight in config.loss.items()}
    return config.model_copy(update={"optim": optim, "loss": loss})


def _frame_weights(points: Sequence[CorrectedPoint], num_frames: int) -> npt.NDArray[np.float64]:
    """[T]: all frames, and as often again those of which something is known."""
    known = np.zeros(num_frames)
    for point in points:
        known[point.frames] += 1
        known[point.hidden] += 1
    return 0.5 / num_frames + 0.5 * known / known.sum()


def _contradicts(
    bent: Sequence[Bent],
    unit: float,
    frame: npt.NDArray[np.integer],
    xy: npt.NDArray[np.floating],
    target: npt.NDArray[np.integer],
    target_xy: npt.NDArray[np.floating],
) -> npt.NDArray[np.bool_]:
    return contradiction(bent, frame, xy, target, target_xy, unit) > CONTRADICTS


def _apart(model: DecoMotion, points: Sequence[CorrectedPoint]) -> tuple[npt.NDArray[np.floating], int]:
    """Pixels [place] from known places to the tracks of their points' first ones; hidden places that are told."""
    apart, hidden = [], 0
    for point in points:
        found = follow(model, point.queries[:1])
        apart.append(np.linalg.norm(found.xy[0, point.frames] - point.xy, axis=-1)[1:])
        hidden += int((found.occlusion[0, point.hidden] > HIDDEN).sum())
    return np.concatenate(apart), hidden


def _told(points: Sequence[CorrectedPoint], before: tuple[npt.NDArray, int], after: tuple[npt.NDArray, int]) -> str:
    """How far the corrections are met."""
    said = []
    if len(before[0]):
        said.append(f"missed by {np.median(after[0]):.1f} px in the median, before by {np.median(before[0]):.1f}")
    if count := sum(len(point.hidden) for point in points):
        said.append(f"{after[1]} of {count} hidden places are told to be hidden, before {before[1]}")
    return "corrections: " + "; ".join(said)
