"""The tracker: the exported model of a clip, asked where points go and what they look like.

No state between calls and no global settings: a `Tracker` may be shared by threads, and pickled for worker processes,
which open the file again. The answer for one query does not depend on the others, nor on how the call is chunked.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from decomo_runtime.card import Card
from decomo_runtime.chunks import query_chunks
from decomo_runtime.dense import Dense, dense_flows
from decomo_runtime.expected_error import expected_error
from decomo_runtime.journey import follow
from decomo_runtime.model import Appearance, Model
from decomo_runtime.model_file import Providers
from decomo_runtime.queries import check_frames, check_queries
from decomo_runtime.tracks import Tracks
from decomo_runtime.windows import WindowModels
from decomotion.quality import Quality

if TYPE_CHECKING:
    from decomotion.frames import AnyFrames


class Tracker:
    """Opens the .onnx file at `path`, or the folder of a long clip's windows (`windows.py`).

    `ModelFileError` where it is not a model that this version reads.

    `providers` are onnxruntime's execution providers in order of preference, or the name of one (default: the CPU);
    `threads` is the number of threads within one operator (default: onnxruntime's choice, one for each core).
    """

    def __init__(
        self, path: str | os.PathLike[str], *, providers: Providers | str | None = None, threads: int | None = None
    ) -> None:
        self.path = Path(path)
        """As it was given."""
        self._opened_with = (Path(path).absolute(), providers, threads)
        self._models = WindowModels(self.path, partial(Model, providers=providers, threads=threads))
        self.facts = self._models.facts
        """What the file says of its clip."""

    @property
    def clip_name(self) -> str:
        """Name of the clip that the model was fitted to."""
        return self.facts.clip_name

    @property
    def num_frames(self) -> int:
        """Number of frames of the clip."""
        return self.facts.num_frames

    @property
    def height(self) -> int:
        """Height of the clip in pixels."""
        return self.facts.height

    @property
    def width(self) -> int:
        """Width of the clip in pixels."""
        return self.facts.width

    @property
    def fps(self) -> float:
        """Frames a second of the clip, in the mean."""
        return self.facts.fps

    @property
    def times(self) -> npt.NDArray[np.float64]:
        """[T], seconds of each frame of the clip, from 0."""
        return self._models.layout.times

    @property
    def pixel_aspect(self) -> float:
        """Width of the clip's pixels over their height."""
        return self.facts.pixel_aspect

    @property
    def preset(self) -> str:
        """Name of the training preset."""
        return self.facts.preset

    @property
    def quality(self) -> Quality | None:
        """How good the fit is, by links that were held out of it; None in files that do not say.

        Of a clip of several windows, that of the window which misses them the most.
        """
        return self.facts.quality

    @property
    def card(self) -> Card:
        """What the model is of, how it came to be, and how good it is, as far as its files tell."""
        return self._models.card(self.path)

    @property
    def occlusion_threshold(self) -> float:
        """Score above which a point counts as occluded."""
        return self.facts.occlusion_threshold

    def track(
        self,
        queries: npt.ArrayLike,
        frames: npt.ArrayLike | None = None,
        *,
        chunk: int | None = None,
        max_memory: int | None = None,
    ) -> Tracks:
        """Follows `queries` [N, 3], rows of (t, x, y), to `frames` [M] (default: every frame of the clip).

        `max_memory` bounds, in bytes and roughly, what the session works with at once (default: 64 MiB), answers not
        counted; `chunk` instead is the number of queries that a call of the session gets. They change memory and
        speed, not the answer (to 0.0001 px). `QueryError` where an argument is malformed, or the memory too little for
        one point.
        """
        queries = check_queries(queries, self.facts)
        frames = check_frames(frames, self.num_frames)
        xy, occlusion = follow(self._models, queries, frames, chunk, max_memory)
        size = self.height, self.width
        occluded = occlusion > self.occlusion_threshold
        error = expected_error(occlusion, queries, frames, self.facts)
        return Tracks(xy, occluded, occlusion, queries, frames, size, self.times[frames], error=error)

    def stream(
        self,
        queries: Iterable[npt.ArrayLike],
        frames: npt.ArrayLike | None = None,
        *,
        max_memory: int | None = None,
    ) -> Iterator[Tracks]:
        """`track` for more queries than fit into memory: takes [n, 3] arrays one by one and yields their tracks.

        An array [N, 3] as a whole is cut into pieces that are asked at once.
        """
        frames = check_frames(frames, self.num_frames)
        if isinstance(queries, np.ndarray) and queries.ndim == 2:
            whole = queries
            parts = query_chunks(len(whole), None, len(frames), self.facts.bytes_per_ray, max_memory)
            queries = (whole[rows] for rows in parts)
        for part in queries:
            yield self.track(part, frames, max_memory=max_memory)

    def refine(self, tracks: Tracks, frames: AnyFrames) -> Tracks:
        """`tracks` of this model at the precision of the clip's own `frames`, RGB uint8 [T, H, W, 3], the whole clip.

        Each answer in sight is registered on the pixels (`refinement.py`) and replaced where that is plainly better:
        `Tracks.refined` says where. Raises `RefinementError` where frames or tracks are not of this model's clip.
        """
        from decomo_runtime.refinement import refine

        return refine(self, tracks, frames)

    def dense(self, frame: int, *, to: int, max_memory: int | None = None) -> Dense:
        """Where each pixel of `frame` is in frame `to`, and whether it is hidden there."""
        return next(dense_flows(self, frame, [to], max_memory))

    def sample(self, queries: npt.ArrayLike, *, chunk: int | None = None, max_memory: int | None = None) -> Appearance:
        """Colours, static confidence and depth that the model renders along the rays of `queries` [N, 3].

        `max_memory` and `chunk` are those of `track`, and so is what is raised.
        """
        return self._models.sample(check_queries(queries, self.facts), chunk, max_memory)

    def on_object(self, queries: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which of `queries` [N, 3] a moving object owns, bool [N]: `track` follows these with it, the others as points
        of the static scene.

        An object owns a point where it has more than the file's share of the ray (`ModelFacts.object_share`); of a ray
        that meets nothing it has none. In files with a table (`bake`) `track` goes by the ray of the nearest place in
        the table. `QueryError` where a query is malformed.
        """
        return self.sample(queries).on_object(self.facts.object_share)

    def __reduce__(self) -> tuple[object, ...]:
        return _reopen, self._opened_with

    def __repr__(self) -> str:
        return f"Tracker({str(self.path)!r}: {self.clip_name}, {self.num_frames} frames of {self.width}x{self.height})"


def _reopen(path: Path, providers: Providers | str | None, threads: int | None) -> Tracker:
    return Tracker(path, providers=providers, threads=threads)
