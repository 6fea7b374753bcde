"""The tracker: one exported model, asked where points go and what they look like.

No state between calls and no global settings: a `Tracker` may be shared by threads, and pickled for worker processes,
which open the file again. The answer for one query does not depend on the others, nor on how the call is chunked.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt

from decomo_runtime import contract
from decomo_runtime.errors import QueryError
from decomo_runtime.model_file import Providers, open_session, read_facts
from decomo_runtime.queries import check_frames, check_queries
from decomo_runtime.rendering import render
from decomo_runtime.tracks import Tracks

RAYS_PER_CALL = 4096
"""Rays that one call of the session may render: each query's own and one for each target frame. Bounds its memory."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """What the model sees along the rays of N queries; colours are RGB in [0, 1], all arrays float32."""

    rgb: npt.NDArray[np.float32]
    """[N, 3], both volumes fused; the next two are the static and the dynamic volume alone."""
    rgb_static: npt.NDArray[np.float32]
    rgb_dynamic: npt.NDArray[np.float32]
    static_confidence: npt.NDArray[np.float32]
    """[N], 1 where the point belongs to the static scene, 0 where it moves by itself."""
    depth: npt.NDArray[np.float32]
    """[N], pseudo-depth from 0 (near) to 2 (far)."""


class Tracker:
    """Opens the .onnx file at `path`; `ModelFileError` where it is not a model that this version reads.

    `providers` are onnxruntime's execution providers in order of preference (default: the CPU); `threads` is the
    number of threads within one operator (default: onnxruntime's choice, one for each core).
    """

    def __init__(
        self, path: str | os.PathLike[str], *, providers: Providers | None = None, threads: int | None = None
    ) -> None:
        self.path = Path(path)
        self._opened_with = (Path(path).absolute(), providers, threads)
        self._session = open_session(self.path, providers, threads)
        self.facts = read_facts(self._session, self.path)

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
        """Frames a second of the clip."""
        return self.facts.fps

    @property
    def preset(self) -> str:
        """Name of the training preset."""
        return self.facts.preset

    @property
    def occlusion_threshold(self) -> float:
        """Score above which a point counts as occluded."""
        return self.facts.occlusion_threshold

    def track(self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None, *, chunk: int | None = None) -> Tracks:
        """Follows `queries` [N, 3], rows of (t, x, y), to `frames` [M] (default: every frame of the clip).

        `chunk` is the number of queries a call of the session gets; by default what keeps memory bounded. It changes
        memory and speed, never the answer.
        """
        queries = check_queries(queries, self.facts)
        frames = check_frames(frames, self.num_frames)
        xy = np.empty((len(queries), len(frames), 2), np.float32)
        occlusion = np.empty((len(queries), len(frames)), np.float32)
        for rows in _chunks(len(queries) if len(frames) else 0, chunk, rays_per_query=1 + len(frames)):
            xy[rows], occlusion[rows] = self._ask((contract.TRACKS, contract.OCCLUSION), queries[rows], frames)
        return Tracks(xy, occlusion > self.occlusion_threshold, occlusion, queries, frames)

    def sample(self, queries: npt.ArrayLike, *, chunk: int | None = None) -> Appearance:
        """Colours, static confidence and depth that the model renders along the rays of `queries` [N, 3]."""
        queries = check_queries(queries, self.facts)
        colours = np.empty((3, len(queries), 3), np.float32)
        scalars = np.empty((2, len(queries)), np.float32)
        outputs = (
            contract.RGB,
            contract.RGB_STATIC,
            contract.RGB_DYNAMIC,
            contract.STATIC_CONFIDENCE,
            contract.DEPTH,
        )
        for rows in _chunks(len(queries), chunk, rays_per_query=1):
            answer = self._ask(outputs, queries[rows], np.empty(0, np.int64))
            colours[:, rows], scalars[:, rows] = answer[:3], answer[3:]
        return Appearance(*colours, *scalars)

    def render(self, frame: int, layer: str = "fused", *, long_side: int | None = None) -> npt.NDArray[np.uint8]:
        """A picture of `frame` as the model has it, uint8 [H, W, 3] RGB; of the clip's size, or with that longer side.

        `layer` is one of `fused`, `static`, `dynamic` ([H, W, 4], RGBA), `mask` and `depth`: see `rendering.py`.
        """
        return render(self, frame, [layer], long_side=long_side)[0]

    def _ask(
        self, outputs: tuple[str, ...], queries: npt.NDArray[np.float32], frames: npt.NDArray[np.int64]
    ) -> list[npt.NDArray[np.float32]]:
        answer = self._session.run(list(outputs), {contract.QUERIES: queries, contract.FRAMES: frames})
        return cast("list[npt.NDArray[np.float32]]", answer)

    def __reduce__(self) -> tuple[object, ...]:
        return _reopen, self._opened_with

    def __repr__(self) -> str:
        return f"Tracker({str(self.path)!r}: {self.clip_name}, {self.num_frames} frames of {self.width}x{self.height})"


def _reopen(path: Path, providers: Providers | None, threads: int | None) -> Tracker:
    return Tracker(path, providers=providers, threads=threads)


def _chunks(count: int, chunk: int | None, rays_per_query: int) -> Iterator[slice]:
    """Slices that cover `count` queries in order."""
    if chunk is None:
        chunk = max(1, RAYS_PER_CALL // rays_per_query)
    elif isinstance(chunk, bool) or not isinstance(chunk, int | np.integer) or chunk < 1:
        raise QueryError(f"chunk must be a whole number of queries, at least 1; got {chunk!r}")
    for start in range(0, count, int(chunk)):
        yield slice(start, start + int(chunk))
