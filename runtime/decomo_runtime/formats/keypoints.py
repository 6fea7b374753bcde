"""Named points that people have labelled, or a pose estimator has found, as points to follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import QueryError

SURE = 0.6
"""The least score of a point to follow: DeepLabCut's own default of what it shows (`pcutoff`)."""


@dataclass(frozen=True, eq=False)
class Keypoints:
    """N points in M frames."""

    names: tuple[str, ...]
    """[N]."""
    frames: npt.NDArray[np.int64]
    """[M], increasing, counted from 0."""
    xy: npt.NDArray[np.float64]
    """[N, M, 2], (x, y) in pixels, pixel centres at whole numbers; NaN where there is none."""
    score: npt.NDArray[np.float64]
    """[N, M], from 0 (hidden, or not there) to 1 (labelled in sight)."""
    size: tuple[int, int] | None = None
    """(height, width) of the images, where the file says it."""

    def queries(self, frame: int | None = None, least: float = SURE) -> tuple[npt.NDArray[np.float64], tuple[str, ...]]:
        """Rows (t, x, y) [K, 3], and names [K], of the points whose score is `least` or more, in the order of `names`.

        Each is taken where it is in `frame`, or else in the frame with its highest score, the first of equals.
        `QueryError` where `frame` is not among `frames`, or no point has such a score.
        """
        score = np.where(np.isfinite(self.xy).all(axis=-1), self.score, -1.0)
        if frame is None:
            column = score.argmax(axis=1) if len(self.frames) else np.zeros(len(self.names), np.int64)
        else:
            found = np.flatnonzero(self.frames == frame)
            if not len(found):
                raise QueryError(f"no keypoints in frame {frame}; they are in {_spans(self.frames)}")
            column = np.full(len(self.names), found[0])
        rows = np.arange(len(self.names))
        kept = np.flatnonzero(score[rows, column] >= least) if len(self.frames) else rows[:0]
        if not len(kept):
            where = "" if frame is None else f" in frame {frame}"
            raise QueryError(f"no keypoint is there{where} with a score of {least:g} or more; give others")
        column = column[kept]
        queries = np.column_stack([self.frames[column], self.xy[kept, column]]).astype(np.float64)
        return queries, tuple(self.names[row] for row in kept)


def _spans(frames: npt.NDArray[np.int64], most: int = 5) -> str:
    shown = ", ".join(str(frame) for frame in frames[:most])
    return f"frames {shown}{', ...' if len(frames) > most else ''}" if len(frames) else "no frame"
