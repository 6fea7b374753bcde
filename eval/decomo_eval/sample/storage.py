"""The sample on disk: `clip/00000.png ...`, `masks/00000.png ...` (255 = moving object), `sample.pkl` (TAP-Vid)."""

from __future__ import annotations

import os
import pickle
import shutil
from pathlib import Path

import numpy as np

from decomo_eval.sample.sample import Sample, SampleError
from decomotion.images import png

VIDEO_NAME = "sample"
CLIP, MASKS, PICKLE = "clip", "masks", "sample.pkl"
PICKLE_PROTOCOL = 4


def write(sample: Sample, directory: str | Path, *, force: bool = False) -> list[Path]:
    """Writes the sample into `directory` and returns the paths of clip, masks and pickle.

    Files are written in full under a temporary name in `directory` and then renamed. What exists there under those
    names must be the very same files, or `force` be given, which replaces it; else raises `SampleError`.
    """
    directory = Path(directory)
    targets = [directory / name for name in (CLIP, MASKS, PICKLE)]
    files = _encode(sample)
    staging = directory / f".sample.{os.getpid()}.partial"
    try:
        present = [target for target in targets if os.path.lexists(target)]
        if present and not force:
            if _is_same(directory, targets, files):
                return targets
            raise SampleError(f"{present[0]} exists already; give another folder, or --force to replace it")
        for name, content in files.items():
            path = staging / "new" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        (staging / "old").mkdir()
        for target in targets:
            if target in present:
                target.rename(staging / "old" / target.name)
            (staging / "new" / target.name).rename(target)
    except OSError as error:
        raise SampleError(
            f"cannot write the sample to {directory}: {error}; give a folder that can be written"
        ) from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return targets


def _encode(sample: Sample) -> dict[str, bytes]:
    """Content of every file by its path below the folder; the pickle holds the clip's own PNGs."""
    frames = [png(frame) for frame in sample.video]
    masks = [png(mask.astype(np.uint8) * 255) for mask in sample.masks]
    record = {VIDEO_NAME: {"video": frames, "points": sample.points, "occluded": sample.occluded}}
    return {
        **{f"{CLIP}/{index:05d}.png": frame for index, frame in enumerate(frames)},
        **{f"{MASKS}/{index:05d}.png": mask for index, mask in enumerate(masks)},
        PICKLE: pickle.dumps(record, PICKLE_PROTOCOL),
    }


def _is_same(directory: Path, targets: list[Path], files: dict[str, bytes]) -> bool:
    """Whether the targets hold exactly `files`."""
    found = [path for target in targets for path in (target.rglob("*") if target.is_dir() else [target])]
    if {path.relative_to(directory).as_posix() for path in found} != set(files):
        return False
    return all((directory / name).read_bytes() == content for name, content in files.items())
