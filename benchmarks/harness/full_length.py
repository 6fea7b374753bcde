"""Figures of clips at full length, of which few frames are annotated: what is not counts as occluded.

Positions are on TAP-Vid's 256x256 raster. Of such annotations < delta_avg and distances mean something in the query
mode `first`, AJ and OA do not; `first32` alone has every one of its frames annotated.
"""

from __future__ import annotations

import functools
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from decomo_eval.dataset import Video, read_dataset
from decomo_eval.measure import score, score_tracks
from decomo_eval.metrics import THRESHOLDS, counted_frames
from decomo_eval.predictions import Prediction, from_model
from decomo_eval.query_mode import FIRST, QUERY_MODES
from decomo_eval.tapvid import Queries, sample_queries
from decomo_runtime import Tracker
from harness.pictures import intersection_over_union
from harness.records import Record
from harness.summary import DELTA

CLIPS, TOOL = Path("data/davis480p"), Path("tools/full_dataset.py")
"""In the folder of real data, the second writes annotations of one kind as a TAP-Vid pickle."""
JOINTS, ENDS, FIRST_32 = "joints", "ends", "first32"
ANNOTATED = 32
"""Frames that `first32` is about."""
CARRIED_FROM = 0
"""The frame whose mask is given."""
LEGS = (*range(6), *range(7, 13))
"""BADJA's joints on legs, of the twenty: three of each."""
LEGS_NEAR = "legs_within_16"
"""Of a record: the mean share of them within 16 pixels."""

Mask = npt.NDArray[np.bool_]
Ask = Callable[[Video, Queries], Prediction]


def clip_names(shared: Path) -> list[str]:
    """The clips, in alphabetic order."""
    return sorted(folder.name for folder in (shared / CLIPS / "frames").iterdir())


def clip_folder(shared: Path, name: str) -> Path:
    """Of its frames."""
    return shared / CLIPS / "frames" / name


def annotated(shared: Path, kind: str, folder: Path) -> dict[str, Video]:
    """The clips that have annotations of a kind; their pickle is written into `folder` where it is not there yet."""
    pickled = folder / f"{kind}.pkl"
    if not pickled.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = pickled.with_suffix(".partial")
        subprocess.run([sys.executable, shared / TOOL, kind, unfinished], check=True, stdout=subprocess.DEVNULL)
        unfinished.rename(pickled)
    return dict(read_dataset(pickled))


def object_masks(shared: Path, name: str) -> Mask:
    """[T, H, W], True on the object."""
    files = sorted((shared / CLIPS / "masks" / name).glob("*.png"))
    return np.stack([np.asarray(Image.open(file)) > 0 for file in files])


def model_asked(model: Path) -> Ask:
    """A fitted model as a tracker."""
    return functools.partial(from_model, model)


def position_figures(video: Video, ask: Ask) -> Record:
    """Of tracks with few annotated frames: `metrics`, `tracks`, a list of < delta_avg of each, and `LEGS_NEAR`.

    Raises what `ask` raises.
    """
    queries = sample_queries(video, FIRST)
    answer = ask(video, queries)
    told = {name: value for name, value in score(queries, answer, FIRST).items() if _is_position(name)}
    each = score_tracks(queries, answer, FIRST)
    tracks, near = each[DELTA], each["pts_within_16"]
    legs = [near[joint] for joint in LEGS if joint < len(near)]
    return {
        "metrics": {FIRST: told},
        "tracks": tracks[~np.isnan(tracks)].tolist(),
        LEGS_NEAR: float(np.nanmean(legs)),
    }


def _is_position(name: str) -> bool:
    return name == DELTA or name in {f"pts_within_{threshold}" for threshold in THRESHOLDS}


def end_figures(video: Video, ask: Ask) -> Record:
    """Of tracks that are annotated in their first and last frame: the list of `errors` at the end, in raster pixels."""
    queries = sample_queries(video, FIRST)
    return {"errors": errors(queries, ask(video, queries)).tolist()}


def errors(queries: Queries, answer: Prediction) -> npt.NDArray[np.float64]:
    """Distances [n] at all points that are in sight after their query."""
    counted = counted_frames(queries.points[None], (1, *queries.occluded.shape), FIRST)[0] & ~queries.occluded
    return np.linalg.norm(answer.tracks - queries.tracks, axis=-1)[counted]


def first_frames_figures(video: Video, ask: Ask, frames: int = ANNOTATED) -> Record:
    """TAP-Vid's `metrics` in the first frames, by query mode, of a model of all frames."""
    metrics = {}
    for mode in QUERY_MODES:
        asked = sample_queries(video, mode)
        answer = ask(video, asked)
        asked = replace(asked, tracks=asked.tracks[:, :frames], occluded=asked.occluded[:, :frames])
        answer = replace(answer, tracks=answer.tracks[:, :frames], occluded=answer.occluded[:, :frames])
        metrics[mode] = score(asked, answer, mode)
    return {"metrics": metrics}


def mask_figures(tracker: Tracker, masks: Mask, every: int) -> Record:
    """J, the intersection over union of the mask of frame 0, carried to all that follow, with theirs [T, H, W].

    `j` in each, over every pixel; `j_seen` over those alone that the model tells to be in sight in frame 0.
    """
    all_pixels, seen_pixels = [], []
    frames = range(CARRIED_FROM + 1, len(masks))
    truths = masks[:, ::every, ::every]
    for frame, (carried, seen) in zip(frames, carry(tracker, masks[CARRIED_FROM], frames, every), strict=True):
        truth = truths[frame]
        all_pixels.append(intersection_over_union(carried[None], truth[None]))
        seen_pixels.append(intersection_over_union((carried & seen)[None], (truth & seen)[None]))
    return {"j": all_pixels, "j_seen": seen_pixels}


def carry(tracker: Tracker, mask: Mask, frames: Sequence[int], every: int) -> Iterator[tuple[Mask, Mask]]:
    """Carries the mask [H, W] of frame 0 to each of `frames`: on the object [h, w], and told to be in sight there.

    A pixel is on the object where the point that it shows lay on it, which every so many rows and columns are asked
    for: of all it is what `Tracker.dense(frame, to=0)` answers.
    """
    y, x = np.mgrid[0 : mask.shape[0] : every, 0 : mask.shape[1] : every]
    edge = np.array([mask.shape[1], mask.shape[0]]) - 1
    for frame in frames:
        asked = np.stack([np.full(x.size, frame), x.ravel(), y.ravel()], axis=1)
        tracks = tracker.track(asked, [CARRIED_FROM])
        place = np.rint(tracks.xy[:, 0]).astype(np.int64)
        inside = ((place >= 0) & (place <= edge)).all(axis=1)
        column, row = np.clip(place, 0, edge).T
        yield (mask[row, column] & inside).reshape(x.shape), ~tracks.occluded[:, 0].reshape(x.shape)
