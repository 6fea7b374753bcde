"""The tracker: one exported model, asked where points go and what they look like.

No state between calls and no global settings: a `Tracker` may be shared by threads, and pickled for worker processes,
which open the file again. The answer for one query does not depend on the others, nor on how the call is chunked.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from decomo_runtime import contract
from decomo_runtime.chunks import frame_chunks, query_chunks
from decomo_runtime.model_file import Providers, open_session, read_facts
from decomo_runtime.queries import check_frames, check_queries
from decomo_runtime.tracks import Tracks
from decomotion.times import steady_times

if TYPE_CHECKING:
    from decomo_runtime.refinement import AnyFrames


@dataclass(frozen=True, eq=False)
class Dense:
    """Where all pixels of one frame are in another."""

    flow: npt.NDArray[np.float32]
    """[H, W, 2], displacement (x, y) in pixels."""
    occluded: npt.NDArray[np.bool_]
    """[H, W], True where the score is above the model's threshold."""
    occlusion: npt.NDArray[np.float32]
    """[H, W], score from 0 (surely in sight) to 1 (surely hidden)."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """What the model sees along the rays of N queries; colours are RGB in [0, 1], all arrays float32."""

    rgb: npt.NDArray[np.float32]
    """[N, 3], both volumes fused; the next two are the static and the dynamic volume alone, as if they were opaque."""
    rgb_static: npt.NDArray[np.float32]
    rgb_dynamic: npt.NDArray[np.float32]
    static_confidence: npt.NDArray[np.float32]
    """[N], static share of the ray: 0 on what moves by itself, 1 on the scene and of a ray that meets nothing."""
    depth: npt.NDArray[np.float32]
    """[N], pseudo-depth from 0 (near) to 2 (far)."""
    static_opacity: npt.NDArray[np.float32]
    """[N], 0 where the static volume has a hole: it has never seen the scene there. 1 in files that do not say."""


class Tracker:
    """Opens the .onnx file at `path`; `ModelFileError` where it is not a model that this version reads.

    `providers` are onnxruntime's execution providers in order of preference, or the name of one (default: the CPU);
    `threads` is the number of threads within one operator (default: onnxruntime's choice, one for each core).
    """

    def __init__(
        self, path: str | os.PathLike[str], *, providers: Providers | str | None = None, threads: int | None = None
    ) -> None:
        self.path = Path(path)
        self._opened_with = (Path(path).absolute(), providers, threads)
        self._session = open_session(self.path, providers, threads)
        self.facts = read_facts(self._session, self.path)
        self._tells_opacity = contract.STATIC_OPACITY in {port.name for port in self._session.get_outputs()}

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
        return steady_times(self.num_frames, self.fps) if self.facts.times is None else np.array(self.facts.times)

    @property
    def pixel_aspect(self) -> float:
        """Width of the clip's pixels over their height."""
        return self.facts.pixel_aspect

    @property
    def preset(self) -> str:
        """Name of the training preset."""
        return self.facts.preset

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
        xy = np.empty((len(queries), len(frames), 2), np.float32)
        occlusion = np.empty((len(queries), len(frames)), np.float32)
        for columns in frame_chunks(len(frames), self.facts.bytes_per_ray, max_memory):
            width = columns.stop - columns.start
            for rows in query_chunks(len(queries), chunk, width, self.facts.bytes_per_ray, max_memory):
                xy[rows, columns], occlusion[rows, columns] = self._ask(
                    contract.TRACKING, queries[rows], frames[columns]
                )
        size = self.height, self.width
        occluded = occlusion > self.occlusion_threshold
        return Tracks(xy, occluded, occlusion, queries, frames, size, self.times[frames])

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
        check_frames([frame, to], self.num_frames)
        y, x = np.indices((self.height, self.width), np.float32)
        queries = np.stack([np.full(x.size, frame, np.float32), x.ravel(), y.ravel()], axis=1)
        tracks = self.track(queries, [to], max_memory=max_memory)
        flow = (tracks.xy[:, 0] - queries[:, 1:]).reshape(*x.shape, 2)
        return Dense(flow, tracks.occluded.reshape(x.shape), tracks.occlusion.reshape(x.shape))

    def sample(self, queries: npt.ArrayLike, *, chunk: int | None = None, max_memory: int | None = None) -> Appearance:
        """Colours, static confidence and depth that the model renders along the rays of `queries` [N, 3].

        `max_memory` and `chunk` are those of `track`, and so is what is raised.
        """
        queries = check_queries(queries, self.facts)
        colours = np.empty((3, len(queries), 3), np.float32)
        scalars = np.ones((3, len(queries)), np.float32)
        outputs = contract.APPEARANCE if self._tells_opacity else contract.APPEARANCE[:-1]
        for rows in query_chunks(len(queries), chunk, 0, self.facts.bytes_per_rendered_ray, max_memory):
            answer = self._ask(outputs, queries[rows], np.empty(0, np.int64))
            colours[:, rows], scalars[: len(answer) - 3, rows] = answer[:3], answer[3:]
        return Appearance(*colours, *scalars)

    def on_object(self, queries: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which of `queries` [N, 3] a moving object owns, bool [N]: `track` follows these with it, the others as points
        of the static scene.

        An object owns a point where it has more than the file's share of the ray (`ModelFacts.object_share`); of a ray
        that meets nothing it has none. In files with a table (`bake`) `track` goes by the ray of the nearest place in
        the table. `QueryError` where a query is malformed.
        """
        return self.sample(queries).static_confidence < 1 - self.facts.object_share

    def _ask(
        self, outputs: tuple[str, ...], queries: npt.NDArray[np.float32], frames: npt.NDArray[np.int64]
    ) -> list[npt.NDArray[np.float32]]:
        answer = self._session.run(list(outputs), {contract.QUERIES: queries, contract.FRAMES: frames})
        return cast("list[npt.NDArray[np.float32]]", answer)

    def __reduce__(self) -> tuple[object, ...]:
        return _reopen, self._opened_with

    def __repr__(self) -> str:
        return f"Tracker({str(self.path)!r}: {self.clip_name}, {self.num_frames} frames of {self.width}x{self.height})"


def _reopen(path: Path, providers: Providers | str | None, threads: int | None) -> Tracker:
    return Tracker(path, providers=providers, threads=threads)
