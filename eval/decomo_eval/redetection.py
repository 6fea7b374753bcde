"""Average Jaccard after re-detection, AJ_RD, of TAPNext++: how well a point is tracked once it has come back.

Axes and coordinates as in `metrics.py`: b video, n query, t frame; (x, y) pixels of TAP-Vid's 256x256 raster.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decomo_eval.metrics import THRESHOLDS, BoolArray, FloatArray, mean_of_defined, ratio

ABSENCES = (1, 4, 16, 64, 256)
"""Frames: the least absences over which the score is averaged."""


def redetection(
    gt_occluded: npt.ArrayLike,
    gt_tracks: npt.ArrayLike,
    pred_occluded: npt.ArrayLike,
    pred_tracks: npt.ArrayLike,
    judged: npt.ArrayLike | None = None,
) -> dict[str, FloatArray]:
    """AJ_RD and what it is the mean of: arrays [b], in 0..1, 1 is best; nan where no point comes back.

    A point comes back in a frame r in which it is visible and before which it was hidden for d > 0 frames, those at the
    video's begin included. The event counts where d is greater than at each earlier event of the track. Of an event,
    over the frames r to the end,

        J_D = TP / (visible + FP),

    TP the frames in which the point is visible, predicted visible and at most D pixels off, FP the others in which it
    is predicted visible. J_D is averaged over the events with d >= m, then over D in 1, 2, 4, 8, 16, then over m in 1,
    4, 16, 64, 256 as far as there are such events.

    The query's frame does not matter, as in the published function (`compute_redetection_metrics` of TAPNext++, Google
    DeepMind's tapnet): where a point is first visible after the video's begin, that, too, is an event.

    Args:
        gt_occluded: bool [b, n, t].
        gt_tracks: [b, n, t, 2].
        pred_occluded: bool [b, n, t].
        pred_tracks: [b, n, t, 2]. A nan is a miss.
        judged: bool [b, n, t], where the truth is known; a track that is not everywhere has no event.

    Returns: redetection_jaccard, which is AJ_RD, and redetection_jaccard_{1,4,16,64,256} by the least absence m.
    """
    visible, pred_visible = ~np.asarray(gt_occluded, dtype=bool), ~np.asarray(pred_occluded, dtype=bool)
    distance = np.linalg.norm(np.subtract(pred_tracks, gt_tracks, dtype=np.float64), axis=-1)
    absence = _absence(visible)
    if judged is not None:
        absence = np.where(np.asarray(judged).all(axis=2, keepdims=True), absence, 0)
    greatest = np.maximum.accumulate(absence, axis=2)
    earlier = np.concatenate([np.zeros_like(greatest[..., :1]), greatest[..., :-1]], axis=2)
    absence = np.where(absence > earlier, absence, 0)

    jaccards = []
    for threshold in THRESHOLDS:
        correct = visible & pred_visible & (distance <= threshold)
        positives = _to_the_end(visible) + _to_the_end(pred_visible & ~correct)
        jaccards.append(ratio(_to_the_end(correct), positives))
    jaccard = np.mean(jaccards, axis=0)

    scores = {}
    for least in ABSENCES:
        events = absence >= least
        total = np.sum(jaccard, axis=(1, 2), where=events)
        scores[f"redetection_jaccard_{least}"] = ratio(total, np.sum(events, axis=(1, 2)))
    mean = mean_of_defined(np.stack(list(scores.values()), axis=1))
    return {"redetection_jaccard": mean, **scores}


def _absence(visible: BoolArray) -> npt.NDArray[np.int64]:
    """[b, n, t]: where the point is visible, for how many frames before it was hidden; 0 where it is hidden."""
    frames = np.arange(visible.shape[2])
    last = np.maximum.accumulate(np.where(visible, frames, -1), axis=2)
    before = np.concatenate([np.full_like(last[..., :1], -1), last[..., :-1]], axis=2)
    return np.where(visible, frames - before - 1, 0)


def _to_the_end(mask: BoolArray) -> npt.NDArray[np.int64]:
    """Number of frames of the mask from each one on."""
    return np.cumsum(mask[..., ::-1], axis=2, dtype=np.int64)[..., ::-1]
