"""Tracks: the answer to a set of queries, and its two file forms (npz to compute with, csv to read)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomotion.arrays import read_npz
from decomotion.files import replacing

SUFFIXES = (".npz", ".csv")
_CSV_HEADER = "point,frame,x,y,occlusion,occluded,query_t,query_x,query_y"
_CSV_FORMAT = "%d,%d,%.4f,%.4f,%.4f,%d,%d,%.4f,%.4f"


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

    def save(self, path: str | Path) -> None:
        """Writes `path`, whole or not at all; its suffix chooses the form.

        npz: `queries` float32 [N, 3] (t, x, y), `tracks` float32 [N, M, 2] (x, y), `occluded` bool [N, M],
        `occlusion` float32 [N, M], `frames` int64 [M]; `height` and `width` int64 where the size is known.
        csv: a line for each point and frame, header `point,frame,x,y,occlusion,occluded,query_t,query_x,query_y`,
        occluded as 0 or 1, four decimals.
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
            return cls._read_csv(Path(path))
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
        }
        for key, shape in shapes.items():
            if arrays[key].shape != shape or arrays[key].dtype.kind not in "biuf":
                raise TracksFileError(
                    f"{path}: {key} must be numbers of the shape {list(shape)}, got {arrays[key].dtype} of "
                    f"{list(arrays[key].shape)}; write it with 'decomo-track'"
                )
        told = [arrays[key] for key in ("height", "width") if key in arrays]
        if any(value.shape != () or value.dtype.kind not in "iu" or value < 1 for value in told) or len(told) == 1:
            raise TracksFileError(f"{path} must hold both height and width, as whole numbers from 1 on, or neither")
        return cls(
            arrays["tracks"].astype(np.float32),
            arrays["occluded"].astype(bool),
            arrays["occlusion"].astype(np.float32),
            arrays["queries"].astype(np.float32),
            arrays["frames"].astype(np.int64),
            (int(told[0]), int(told[1])) if told else None,
        )

    @classmethod
    def _read_csv(cls, path: Path) -> Tracks:
        try:
            with open(path, encoding="utf-8") as file:
                header, *rows = file.read().splitlines()
            if header != _CSV_HEADER:
                raise ValueError("another header")
            lines = np.array([row.split(",") for row in rows], np.float64).reshape(-1, _CSV_HEADER.count(",") + 1)
        except (OSError, ValueError) as error:
            raise TracksFileError(
                f"{path} is not a csv file of tracks, {_CSV_HEADER}; write one with 'decomo-track'"
            ) from error
        points = int(lines[:, 0].max(initial=-1)) + 1
        whole = points > 0 and len(lines) % points == 0
        length = len(lines) // points if whole else 0
        if len(lines) and not (whole and (lines[:, 0] == np.repeat(np.arange(points), length)).all()):
            raise TracksFileError(f"{path} must have a line for each point and frame, in order; some are missing")
        table = lines.reshape(points, length, _CSV_HEADER.count(",") + 1)
        queries = table[:, 0, 6:] if length else np.empty((0, 3))
        frames = table[0, :, 1] if points else np.empty(0)
        return cls(
            table[..., 2:4].astype(np.float32),
            table[..., 5].astype(bool),
            table[..., 4].astype(np.float32),
            queries.astype(np.float32),
            frames.astype(np.int64),
        )

    def _write_npz(self, path: Path) -> None:
        arrays: dict[str, Any] = {
            "queries": self.queries,
            "tracks": self.xy,
            "occluded": self.occluded,
            "occlusion": self.occlusion,
            "frames": self.frames,
        }
        if self.size is not None:
            arrays |= {"height": np.int64(self.size[0]), "width": np.int64(self.size[1])}
        with open(path, "wb") as file:
            np.savez_compressed(file, **arrays)

    def _write_csv(self, path: Path) -> None:
        point, column = np.indices(self.occluded.shape).reshape(2, -1)
        lines = np.column_stack(
            [
                point,
                self.frames[column],
                self.xy.reshape(-1, 2),
                self.occlusion.ravel(),
                self.occluded.ravel(),
                self.queries[point],
            ]
        )
        np.savetxt(path, lines, fmt=_CSV_FORMAT, header=_CSV_HEADER, comments="", encoding="utf-8")
