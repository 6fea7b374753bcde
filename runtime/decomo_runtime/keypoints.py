"""Files of named points, read as points to follow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from decomo_runtime.errors import QueryError
from decomo_runtime.formats import coco, deeplabcut
from decomo_runtime.formats.keypoints import Keypoints


def read_keypoints(path: str | Path, files: Sequence[str] = (), first: int | None = None) -> Keypoints:
    """Reads a file of DeepLabCut (.csv, .h5: labels or predictions) or COCO keypoints (.json), by its ending.

    `files` are the names of the clip's frames, `first` is the number of its first frame in names of images: what COCO
    may need to tell the frames (`formats/coco.py`). `QueryError` where the file is none of these.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".json":
        return coco.read_keypoints(path, files, first)
    if suffix in (".csv", ".h5"):
        return deeplabcut.read_keypoints(path)
    raise QueryError(f"{path} is no file of keypoints by its ending; give DeepLabCut's .csv or .h5, or COCO's .json")
