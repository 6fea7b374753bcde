"""One exported model: the window of a clip that it was fitted to, opened and asked.

What is asked is taken as checked (`queries.py`); frames count from the window's first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt

from decomo_runtime import contract
from decomo_runtime.chunks import frame_chunks, query_chunks
from decomo_runtime.model_file import Providers, open_session, read_facts

Floats = npt.NDArray[np.float32]


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

    def on_object(self, share: float) -> npt.NDArray[np.bool_]:
        """[N]: whether a moving object has more than this share of the ray (`ModelFacts.object_share`)."""
        return self.static_confidence < 1 - share


class Model:
    """Opens the .onnx file at `path`, with what `Tracker` says; `ModelFileError` where it is no model."""

    def __init__(self, path: Path, providers: Providers | str | None = None, threads: int | None = None) -> None:
        self._session = open_session(path, providers, threads)
        self.facts = read_facts(self._session, path)
        self.providers = tuple(self._session.get_providers())
        self._tells_opacity = contract.STATIC_OPACITY in {port.name for port in self._session.get_outputs()}

    def track(
        self, queries: Floats, frames: npt.NDArray[np.int64], chunk: int | None = None, max_memory: int | None = None
    ) -> tuple[Floats, Floats]:
        """Places [N, M, 2] in pixels and occlusion [N, M] of `queries` [N, 3] in `frames` [M]."""
        xy = np.empty((len(queries), len(frames), 2), np.float32)
        occlusion = np.empty((len(queries), len(frames)), np.float32)
        for columns in frame_chunks(len(frames), self.facts.bytes_per_ray, max_memory):
            width = columns.stop - columns.start
            for rows in query_chunks(len(queries), chunk, width, self.facts.bytes_per_ray, max_memory):
                xy[rows, columns], occlusion[rows, columns] = self._ask(
                    contract.TRACKING, queries[rows], frames[columns]
                )
        return xy, occlusion

    def sample(self, queries: Floats, chunk: int | None = None, max_memory: int | None = None) -> Appearance:
        """What the model sees along the rays of `queries` [N, 3]."""
        colours = np.empty((3, len(queries), 3), np.float32)
        scalars = np.ones((3, len(queries)), np.float32)
        outputs = contract.APPEARANCE if self._tells_opacity else contract.APPEARANCE[:-1]
        for rows in query_chunks(len(queries), chunk, 0, self.facts.bytes_per_rendered_ray, max_memory):
            answer = self._ask(outputs, queries[rows], np.empty(0, np.int64))
            colours[:, rows], scalars[: len(answer) - 3, rows] = answer[:3], answer[3:]
        return Appearance(*colours, *scalars)

    def _ask(self, outputs: tuple[str, ...], queries: Floats, frames: npt.NDArray[np.int64]) -> list[Floats]:
        answer = self._session.run(list(outputs), {contract.QUERIES: queries, contract.FRAMES: frames})
        return cast("list[Floats]", answer)
