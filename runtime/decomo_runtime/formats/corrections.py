"""Keypoints that people have labelled as `corrections.csv` of `decomo-train --corrections` (`docs/corrections.md`)."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from decomo_runtime.errors import QueryError
from decomo_runtime.formats.keypoints import SURE, Keypoints
from decomo_runtime.keypoints import read_keypoints
from decomotion.files import replacing

HEADER = ("t", "x", "y", "target_t", "target_x", "target_y", "name")


def convert_keypoints(path: str | Path, out: str | Path, files: Sequence[str] = ()) -> tuple[int, int]:
    """Reads a file of keypoints (`read_keypoints`, which `files` is for) and writes `out`, whole or not at all.

    Returns the numbers of points and of corrections. Raises `QueryError` where the file is none, or says of no point
    where it is in two frames.
    """
    lines = corrections_of(read_keypoints(path, files))
    if not lines:
        raise QueryError(f"{path} has no keypoint in sight in one frame and known in another; label more frames")
    with replacing(out) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows(lines)
    return len({line[-1] for line in lines}), len(lines)


def corrections_of(keypoints: Keypoints) -> list[tuple[object, ...]]:
    """Lines of `HEADER`: each point, named by its place in the first frame in which it is in sight, in all others.

    It is in sight where its score is `SURE` or more, and hidden where it has a place and the score 0. A frame in which
    it has neither says nothing.
    """
    placed = np.asarray(np.isfinite(keypoints.xy).all(axis=-1))
    lines: list[tuple[object, ...]] = []
    for name, xy, score, there in zip(keypoints.names, keypoints.xy, keypoints.score, placed, strict=True):
        seen, hidden = there & (score >= SURE), there & (score == 0)
        if not seen.any():
            continue
        first = int(seen.argmax())
        named = (int(keypoints.frames[first]), *_written(xy[first]))
        for column in np.flatnonzero(seen | hidden):
            if column != first:
                target = _written(xy[column]) if seen[column] else ("", "")
                lines.append((*named, int(keypoints.frames[column]), *target, name))
    return lines


def _written(xy: np.ndarray) -> tuple[str, str]:
    x, y = (f"{value:.4f}".rstrip("0").rstrip(".") for value in xy)
    return x, y
