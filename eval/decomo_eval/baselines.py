"""Point tracks by optical flow alone: what every tracker has to beat, and what supervises our fit.

    chain     frame by frame; hidden from the first cycle error above 1.0 px on, and for good. RAFT-C of the paper's
              table, with RAFT
    direct    from the query's frame straight to each other; hidden where the cycle error passes 1.5 px. RAFT-D
    multi     over several gaps, the best hop at each frame by consistency and occlusion, in the manner of MFT (Neoral
              et al., WACV 2024) without its learned uncertainty; as the fit links its supervision
              (`decomotion/data/links/linking.py`), but without its matches by appearance

Cycle errors are forward-backward errors in pixels of a frame whose longer side is 256. Flow and linking are the
trainer's and are imported when a baseline is made: the rest of the toolkit does without its libraries.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import Video
from decomo_eval.errors import EvalError
from decomo_eval.names import BASELINES, FLOWS
from decomo_eval.predictions import Prediction
from decomo_eval.tapvid import Queries, pixels_to_raster
from decomotion.frames import AnyFrames
from decomotion.units import unit

if TYPE_CHECKING:
    from decomotion.data.config import DataConfig
    from decomotion.data.flow import FlowEstimator
    from decomotion.data.links.linking import Flow

FINE = tuple(
    f"data.flow.{each}" for each in ("descent_iterations=25", "refinement_iterations=10", f"coarse_from={2**31 - 1}")
)
"""A baseline has all the time for DIS that it can use: the fit's supervision takes less of it."""
CHAIN_CYCLE, DIRECT_CYCLE = 1.0, 1.5
KEPT_BYTES = 2**30
"""Of a video's fields that are kept: `direct` needs one for every pair of frames."""

Tracked = tuple[npt.NDArray[np.floating], npt.NDArray[np.bool_]]
"""Positions [N, T, 2] in pixels of the fields' raster, and [N, T], True where hidden."""


class FlowBaseline:
    """A tracker for `evaluate`: `FlowBaseline("chain")(video, queries)`.

    Args:
        method: `chain`, `direct` or `multi`.
        flow: `dis`, which needs no weights, `raft-small` or `raft-large`.
        weights: file of RAFT's weights; by default torchvision's, by download.

    Raises `EvalError` where a name is unknown, `decomotion.errors.InputError` where weights do not fit.
    """

    def __init__(self, method: str, flow: str = FLOWS[0], weights: str | None = None) -> None:
        for kind, given, known in (("baseline", method, BASELINES), ("flow", flow, FLOWS)):
            if given not in known:
                raise EvalError(f"there is no {kind} {given}; choose of {', '.join(known)}")
        if weights is not None and flow == FLOWS[0]:
            raise EvalError(f"{flow} has no weights; leave out --flow-weights, or take --flow raft-large")
        try:
            from decomotion.config import load
            from decomotion.data.flow import build_flow
            from decomotion.device import choose_device

            import_module("decomotion.data.links.linking")  # missing libraries show here, not in the middle of a video
        except ModuleNotFoundError as error:
            raise EvalError(
                f"--baseline needs the training extra ({error.name} is not installed); run: pip install "
                "'decomotion[train]'"
            ) from error

        chosen = FINE if flow == FLOWS[0] else () if weights is None else (f"data.flow.weights={weights}",)
        self.name = f"{method}-{flow}"
        self._method = method
        self._data = load("cpu", overrides=chosen, flow=flow).data
        self._estimate = build_flow(self._data.flow, choose_device("auto"))

    def __call__(self, video: Video, queries: Queries) -> Prediction:
        """Tracks of the queries; what leaves the image is hidden. Raises `EvalError` where there is but one frame."""
        if video.num_frames < 2:
            raise EvalError(f"video {video.name} has one frame and flow needs two; name the others by --videos")
        return track(self._method, queries, self.fields(video.frames()), self._data)

    def fields(self, frames: AnyFrames) -> Fields:
        """Flow between any two of `frames` [T, H, W, 3], RGB, as this baseline has it."""
        return Fields(frames, self._estimate)


class Fields:
    """Flow between any two frames of a clip, computed when first asked for and kept, up to `KEPT_BYTES`.

    Args:
        frames: [T, H, W, 3], RGB.
        estimate: the estimator.
    """

    def __init__(self, frames: AnyFrames, estimate: FlowEstimator) -> None:
        self._frames, self._estimate = frames, estimate
        self._kept: dict[tuple[int, int], npt.NDArray[np.float16]] = {}

    def __call__(self, source: int, target: int) -> Flow:
        """[h, w, 2], in pixels of the field's own raster, to the precision of float16."""
        field = self._kept.get((source, target))
        if field is None:
            field = self._estimate(self._frames[source], self._frames[target], (source, target)).astype(np.float16)
            if (len(self._kept) + 1) * field.nbytes <= KEPT_BYTES:
                self._kept[source, target] = field
        return field.astype(np.float32)

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self._frames)

    @property
    def frame_size(self) -> tuple[int, int]:
        """(width, height) of the frames, in pixels."""
        return self._frames.shape[2], self._frames.shape[1]


def linked(
    asked: npt.NDArray[np.float32], fields: Fields, intervals: tuple[int, ...], threshold: float, max_gap: int
) -> Tracked:
    """Tracks of queries [N, 3], (t, x, y) on the fields' raster, over hops of the given gaps; hidden past `max_gap`."""
    from decomotion.data.links.linking import link

    frame = asked[:, 0].astype(int)
    place = np.array([(frame[:row] == frame[row]).sum() for row in range(len(frame))], int)  # among its frame's
    points = np.zeros((fields.num_frames, place.max(initial=0) + 1, 2), np.float32)
    points[frame, place] = asked[:, 1:]
    xy = np.repeat(asked[:, None, 1:], fields.num_frames, axis=1)
    hidden = np.arange(fields.num_frames) != frame[:, None]
    for step in (1, -1):
        for links in link(points, fields, intervals, threshold, max_gap, step):
            for row, source in enumerate(links.sources):
                mine = np.nonzero(frame == source)[0]
                xy[mine, links.target] = links.xy[row, place[mine]]
                hidden[mine, links.target] = links.occluded[row, place[mine]]
    return xy, hidden


def direct(asked: npt.NDArray[np.float32], fields: Fields, threshold: float) -> Tracked:
    """Tracks of queries [N, 3], (t, x, y) on the fields' raster, each frame reached in one hop."""
    from decomotion.data.links.linking import cycle_error
    from decomotion.data.sampling import bilinear

    frame = asked[:, 0].astype(int)
    xy = np.repeat(asked[:, None, 1:], fields.num_frames, axis=1)
    hidden = np.zeros(xy.shape[:2], bool)
    for source in np.unique(frame).tolist():
        mine = np.nonzero(frame == source)[0]
        here = asked[None, mine, 1:]
        for target in [target for target in range(fields.num_frames) if target != source]:
            forward = fields(source, target)
            there = here + bilinear(forward, here)
            error = cycle_error(here, there, fields(target, source)) / unit(*forward.shape[:2])
            xy[mine, target], hidden[mine, target] = there[0], error[0] > threshold
    return xy, hidden


def intervals(data: DataConfig, num_frames: int) -> tuple[int, ...]:
    """The gaps of the fit's supervision where time does not matter."""
    from decomotion.data.links.intervals import choose_intervals

    return choose_intervals(data.flow, num_frames, data.pool.max_gap, affordable=lambda _: True)


METHODS: dict[str, Callable[[npt.NDArray[np.float32], Fields, DataConfig], Tracked]] = {
    "chain": lambda asked, fields, data: linked(asked, fields, (1,), CHAIN_CYCLE, fields.num_frames),
    "direct": lambda asked, fields, data: direct(asked, fields, DIRECT_CYCLE),
    "multi": lambda asked, fields, data: linked(
        asked, fields, intervals(data, fields.num_frames), data.pool.cycle_threshold, data.pool.max_gap
    ),
}
"""Ways to go from flow to tracks, by the names of `names.BASELINES`."""


def track(method: str, queries: Queries, fields: Fields, data: DataConfig) -> Prediction:
    """Answers a benchmark's queries by one of `METHODS`; what leaves the image is hidden."""
    from decomotion.data.links.linking import outside

    height, width = fields(0, 1).shape[:2]
    xy, hidden = METHODS[method](queries.in_pixels(width, height), fields, data)
    return Prediction(pixels_to_raster(xy, width, height), hidden | outside(xy, height, width), fields.frame_size)
