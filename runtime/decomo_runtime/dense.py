"""Dense correspondence: where all pixels of a frame are in others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from decomo_runtime.model_file import ModelFacts
from decomo_runtime.queries import check_frames
from decomo_runtime.tracks import Tracks

ANSWERS = 2**28
"""Bytes of answers that are kept at once: frames that are asked for together share the work of their queries."""
_BYTES = 17
"""Of one answer: place, score, whether it is hidden, and error."""


@dataclass(frozen=True, eq=False)
class Dense:
    """Where all pixels of one frame are in another."""

    flow: npt.NDArray[np.float32]
    """[H, W, 2], displacement (x, y) in pixels."""
    occluded: npt.NDArray[np.bool_]
    """[H, W], True where the score is above the model's threshold."""
    occlusion: npt.NDArray[np.float32]
    """[H, W], score from 0 (surely in sight) to 1 (surely hidden)."""
    error: npt.NDArray[np.float32] | None = None
    """[H, W], expected error in pixels, as of `Tracks`; None where the tracker does not say."""


class AnyTracker(Protocol):
    """What is asked of a `Tracker`."""

    @property
    def facts(self) -> ModelFacts:
        """Of the clip and its model."""
        ...

    def track(
        self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None, *, max_memory: int | None = None
    ) -> Tracks:
        """Follows `queries` [N, 3] to `frames` [M]."""
        ...


def dense_flows(
    tracker: AnyTracker, frame: int, targets: Sequence[int], max_memory: int | None = None
) -> Iterator[Dense]:
    """Where each pixel of `frame` is in each frame of `targets`, in their order.

    `max_memory` is that of `Tracker.track`. `QueryError` where a frame is none of the clip.
    """
    height, width = tracker.facts.height, tracker.facts.width
    check_frames([frame, *targets], tracker.facts.num_frames)
    y, x = np.indices((height, width), np.float32)
    queries = np.stack([np.full(x.size, frame, np.float32), x.ravel(), y.ravel()], axis=1)
    step = max(1, ANSWERS // (_BYTES * x.size))
    for begin in range(0, len(targets), step):
        tracks = tracker.track(queries, list(targets[begin : begin + step]), max_memory=max_memory)
        for column in range(len(tracks.frames)):
            flow = (tracks.xy[:, column] - queries[:, 1:]).reshape(height, width, 2)
            occluded = tracks.occluded[:, column].reshape(x.shape)
            occlusion = tracks.occlusion[:, column].reshape(x.shape)
            error = None if tracks.error is None else tracks.error[:, column].reshape(x.shape)
            yield Dense(flow, occluded, occlusion, error)
