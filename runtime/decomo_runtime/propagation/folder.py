"""Annotations of some frames in files, carried to all frames, in files of the same format."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from decomo_runtime.formats.frames import clip_files
from decomo_runtime.overlay import check_clip
from decomo_runtime.propagation import report
from decomo_runtime.propagation.carrying import Finding, propagate
from decomo_runtime.propagation.formats import registry
from decomo_runtime.propagation.formats.asked import ClipFacts
from decomo_runtime.propagation.report import Report
from decomo_runtime.propagation.shapes import Shape
from decomotion.clip import read_clip
from decomotion.files import new_folder

if TYPE_CHECKING:
    from decomo_runtime.tracker import Tracker

Source = str | Path | tuple[str | Path, int | None]


def propagate_files(
    tracker: Tracker,
    annotations: Sequence[Source],
    folder: str | Path,
    *,
    clip: str | Path | None = None,
    progress: bool = False,
) -> Report:
    """Carries what is drawn in files to all frames; the folder has it in the same format, and `report.csv`.

    Args:
        tracker: the model.
        annotations: files of one format (`formats/registry.py`), or (file, frame).
        folder: new or empty; it appears whole or not at all.
        clip: the frames or video that the model was fitted to: then regions have their rims on its edges.
        progress: whether to show it.

    Raises `AnnotationError` where a file cannot be read or is not of this clip, `OverlayError` where `clip` is another,
    `OSError` where `folder` has something in it.
    """
    frames, files = None, ()
    if clip is not None:
        opened = read_clip(clip)
        check_clip(opened, tracker.facts)
        frames, files = opened.frames, [file.name for file in clip_files(Path(clip))]
    about = ClipFacts((tracker.height, tracker.width), tracker.num_frames, tracker.clip_name, files)
    sources = [(Path(each[0]), each[1]) if isinstance(each, tuple) else (Path(each), None) for each in annotations]
    annotation, form = registry.read(sources, about)
    carried = propagate(tracker, annotation, frames)
    findings: list[Finding] = []

    def noted(carried: Iterable[tuple[list[Shape], list[Finding]]]) -> Iterator[tuple[int, list[Shape]]]:
        for frame, (shapes, found) in enumerate(carried):
            findings.extend(found)
            yield frame, shapes

    with new_folder(folder) as temporary:
        with tqdm(carried, "propagate", total=tracker.num_frames, leave=False, disable=not progress) as bar:
            form.write(temporary, annotation, noted(bar), about)
        told = Report(annotation.things, tuple(findings))
        told.write(temporary / report.FILE)
    return told
