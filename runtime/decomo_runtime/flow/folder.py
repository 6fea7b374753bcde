"""Writes dense correspondence of many pairs of frames to a folder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from decomo_runtime.dense import dense_flows
from decomo_runtime.flow.found import Found
from decomo_runtime.flow.registry import format_named
from decomo_runtime.flow.series import Origin, Series, Target, series_of
from decomotion.files import new_folder

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker


@dataclass(frozen=True)
class Written:
    """What `write_flow` has written."""

    pairs: int
    """Of frames, a file each."""
    occluded: float
    """Share of all their pixels."""


def write_flow(
    tracker: Tracker,
    folder: str | Path,
    origin: Origin,
    target: Target,
    *,
    format: str = "flo",
    both: bool = False,
    max_memory: int | None = None,
    progress: bool = False,
) -> Written:
    """Writes where all pixels of frame `origin` are in frame `target`, a file for each pair of frames.

    Args:
        tracker: the model.
        folder: new or empty; it appears whole or not at all. `series.py` says what is in it.
        origin: a frame, or "all".
        target: a frame, "all", or "next", the frame after each.
        format: one of `registry.FORMATS`.
        both: the opposite direction as well.
        max_memory: as of `Tracker.track`.
        progress: whether to show it.

    Raises `FlowError` where the frames or the format do not exist, or a library is missing; `OSError` where `folder`
    has something in it.
    """
    form = format_named(format)
    form.check()
    wanted = series_of(origin, target, both, tracker.num_frames)
    total = sum(len(each.pairs) for each in wanted)
    hidden = 0.0
    with (
        new_folder(folder) as temporary,
        tqdm(_found(tracker, wanted, max_memory), "flow", total=total, leave=False, disable=not progress) as bar,
    ):
        for name, found in bar:
            path = temporary / f"{name}{form.ending}"
            path.parent.mkdir(exist_ok=True)
            form.write(found, path)
            hidden += float(found.dense.occluded.mean())
    return Written(total, hidden / total)


def _found(tracker: Tracker, wanted: Iterable[Series], max_memory: int | None) -> Iterator[tuple[str, Found]]:
    """Each pair's file, without its ending, and what goes into it."""
    for series in wanted:
        numbers = iter(series.numbers)
        for origin, targets in series.by_origin():
            answers = dense_flows(tracker, origin, targets, max_memory)
            for target, dense in zip(targets, answers, strict=True):
                yield f"{series.folder}/{next(numbers):05d}", Found(dense, origin, target, tracker.pixel_aspect)
