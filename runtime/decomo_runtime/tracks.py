"""Tracks: the answer to a set of queries, and its two file forms (npz to compute with, csv to read)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.tracks_csv import read_csv, write_csv
from decomotion.arrays import read_npz
from decomotion.files import replacing

SUFFIXES = (".npz", ".csv")


@dataclass(frozen=True, eq=False)
class Tracks:
    """Where N query points are in M frames."""

    xy: npt.NDArray[np.float32]
    """[N, M, 2], (x, y) in pixels of the clip; outside of the frame where the point has left it."""
    occluded: npt.NDArray[np.bool_]
    """[N, M], True where the score is above the model's threshold."""
    occlusion: npt.NDArray[np.float32]
    """[N, M], score from 0 (surely in sight) to 1 (surely hidden)."""
    queries: npt.NDArray[np.float32]
    """[N, 3], (t, x, y)."""
    frames: npt.NDArray[np.int64]
    """[M], the frame number of each column."""
    size: tuple[int, int] | None = None
    """(height, width) of the clip in pixels; None where a file does not say."""
    times: npt.NDArray[np.float64] | None = None
    """[M], seconds of each column's frame from the clip's first; None where a file does not say."""
    refined: npt.NDArray[np.bool_] | None = None
    """[N, M], True where the place was found in the clip's own pixels (`Tracker.refine`) and is not the model's answer;
    None where nothing was sought."""

    def save(self, path: str | Path) -> None:
        """Writes `path`, whole or not at all; its suffix chooses the form.

        npz: `queries` float32 [N, 3] (t, x, y), `tracks` float32 [N, M, 2] (x, y), `occluded` bool [N, M],
        `occlusion` float32 [N, M], `frames` int64 [M]; where they are known, `height` and `width` int64, and `times`
        float64 [M], seconds; of refined tracks, `refined` bool [N, M].
        csv: a line for each point and frame, header `point,frame,x,y,occlusion,occluded,query_t,query_x,query_y`,
        occluded as 0 or 1, four decimals; where the times are known, `time` is the last column, in seconds.
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix not in SUFFIXES:
            raise TracksFileError(f"tracks are written as {' or '.join(SUFFIXES)}; {path} is neither")
        with replacing(path) as temporary:
            if suffix == ".npz":
                self._write_npz(temporary)
            else:
                self._write_csv(temporary)

    @classmethod
    def load(cls, path: str | Path) -> Tracks:
        """Reads a file that `save` wrote, or an npz of the same keys; without `frames` they count from 0.

        A csv has no line for a point without frames, four decimals, and nothing of the clip's size. `TracksFileError`
        where it is another file.
        """
        if Path(path).suffix.lower() == ".csv":
            arrays: dict[str, Any] = read_csv(Path(path))
            return cls(**arrays)
        arrays = read_npz(Path(path), TracksFileError, remedy="write one with 'decomo-track'")
        missing = {"queries", "tracks", "occluded", "occlusion"} - arrays.keys()
        if missing:
            raise TracksFileError(f"{path} lacks the arrays {', '.join(sorted(missing))}; write it with 'decomo-track'")
        points, length = arrays["tracks"].shape[:2] if arrays["tracks"].ndim == 3 else (0, 0)
        arrays.setdefault("frames", np.arange(length))
        each = (points, length)
        shapes = {
            "tracks": (*each, 2),
            "occluded": each,
            "occlusion": each,
            "queries": (points, 3),
            "frames": (length,),
            **({"times": (length,)} if "times" in arrays else {}),
            **({"refined": each} if "refined" in arrays else {}),
        }
        for key, shape in shapes.items():
            if arrays[key].shape != shape or arrays[key].dtype.kind not in "biuf":
                raise TracksFileError(
                    f"{path}: {key} must be numbers of the shape {list(shape)}, got {arrays[key].dtype} of "
                    f"{list(arrays[key].shape)}; write it with 'decomo-track'"
                )
        frames = arrays["frames"].astype(np.float64)
        if not ((np.abs(frames) < 2**53) & (frames == np.floor(frames))).all():
            raise TracksFileError(f"{path}: frames must be whole numbers; write it with 'decomo-track'")
        told = [arrays[key] for key in ("height", "width") if key in arrays]
        if any(value.shape != () or value.dtype.kind not in "iu" or value < 1 for value in told) or len(told) == 1:
            raise TracksFileError(f"{path} must hold both height and width, as whole numbers from 1 on, or neither")
        with np.errstate(over="ignore"):  # places beyond float32 are infinitely far
            floats = {key: arrays[key].astype(np.float32) for key in ("tracks", "occlusion", "queries")}
        return cls(
            floats["tracks"],
            arrays["occluded"].astype(bool),
            floats["occlusion"],
            floats["queries"],
            arrays["frames"].astype(np.int64),
            (int(told[0]), int(told[1])) if told else None,
            arrays["times"].astype(np.float64) if "times" in arrays else None,
            arrays["refined"].astype(bool) if "refined" in arrays else None,
        )

    def _write_npz(self, path: Path) -> None:
        arrays: dict[str, Any] = {
            "queries": self.queries,
            "tracks": self.xy,
            "occluded": self.occluded,
            "occlusion": self.occlusion,
            "frames": self.frames,
            **({} if self.times is None else {"times": self.times}),
            **({} if self.refined is None else {"refined": self.refined}),
        }
        if self.size is not None:
            arrays |= {"height": np.int64(self.size[0]), "width": np.int64(self.size[1])}
        with open(path, "wb") as file:
            np.savez_compressed(file, **arrays)

    def _write_csv(self, path: Path) -> None:
        with open(path, "w", encoding="utf-8", newline="") as file:
            write_csv(
                file,
                xy=self.xy,
                occluded=self.occluded,
                occlusion=self.occlusion,
                queries=self.queries,
                frames=self.frames,
                times=self.times,
            )
