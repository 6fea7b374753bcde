"""Figures of benchmarks beside TAP-Vid's, each as the benchmark's own code counts it, to be compared with its tables.

Axes: n track, t frame, of one video, each track asked in the frame in which it is first visible (the query mode
`first`). Positions are (x, y) pixels of TAP-Vid's 256x256 raster, in which most thresholds are; where it is said, they
are of a raster of 512x384, to which the codes of EgoPoints and BADJA bring the frames. Figures are shares, 0..1, but
those of `IN_PIXELS`, which are pixels at 256x256; nan where there is nothing to count.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from decomo_eval.metrics import THRESHOLDS
from decomo_runtime.layouts import RASTER_SIZE

FloatArray = npt.NDArray[np.floating]
BoolArray = npt.NDArray[np.bool_]

FAR_THRESHOLDS = (8, 16, 24)
"""Pixels: EgoPoints' d_avg* and re-identification."""
FAILURE, FAILURE_IN_CODE = 50, 16
"""Pixels: a track fails where it is farther off; of the paper of PointOdyssey, and of the code of PIPs++."""
INPUT_SIZE = (512, 384)
"""(width, height) of the frames on which EgoPoints and BADJA are scored."""
PCK_SHARE, PCK_PIXELS = 0.2, 3
"""Of the square root of the animal's area, and pixels at 512x384."""
IN_PIXELS = ("pointodyssey_mte", "egopoints_mte")


def pointodyssey(tracks: FloatArray, true: FloatArray, valid: BoolArray) -> dict[str, float]:
    """PointOdyssey's (Zheng et al., ICCV 2023; `test_on_pod.py` of PIPs++).

    Args:
        tracks: [n, t, 2], the answers.
        true: [n, t, 2].
        valid: [n, t], where the true position is known and in the image, also where it is hidden.

    Returns:
        pointodyssey_d_avg: share of the valid points of the frames 1, 2, ... that are less than D pixels off, averaged
            over D in 1, 2, 4, 8, 16.
        pointodyssey_survival: mean over tracks and frames, frame 0 included, of [no valid point up to here was more
            than 50 pixels off], as in the paper; pointodyssey_survival_16: the same with 16, as in the code.
        pointodyssey_mte: median over a track's valid points, frame 0 included, of the distance, averaged over tracks.
    """
    distance = _distance(tracks, true)
    return {
        "pointodyssey_d_avg": _within(distance[:, 1:], valid[:, 1:], THRESHOLDS),
        "pointodyssey_survival": _survival(distance, valid, FAILURE),
        "pointodyssey_survival_16": _survival(distance, valid, FAILURE_IN_CODE),
        "pointodyssey_mte": _median_error(distance, valid),
    }


def dynamic_replica(
    tracks: FloatArray, true: FloatArray, visible: BoolArray, size: tuple[int, int]
) -> dict[str, float]:
    """Dynamic Replica's, as CoTracker reports them (`Evaluator.compute_metrics`).

    Its pixels are those of the frame times 255 / (width - 1) and 255 / (height - 1).

    Args:
        tracks: [n, t, 2], the answers.
        true: [n, t, 2], known also where it is hidden or outside the image.
        visible: [n, t].
        size: (width, height) of the stored frames.

    Returns:
        dynamic_replica_d_avg, _d_vis, _d_occ: share of the points after the frame in which each is first visible, all,
            the visible and the hidden ones, that are less than D pixels off, averaged over D in 1, 2, 4, 8, 16.
        dynamic_replica_survival: mean over tracks and all frames of [no visible point up to here was more than 50 off].
    """
    stored = np.array(size)
    scale = stored / RASTER_SIZE * 255 / (stored - 1).clip(1)
    distance = _distance(tracks * scale, true * scale)
    after = np.arange(visible.shape[1]) > visible.argmax(axis=1)[:, None]
    return {
        "dynamic_replica_d_avg": _within(distance, after, THRESHOLDS),
        "dynamic_replica_d_vis": _within(distance, after & visible, THRESHOLDS),
        "dynamic_replica_d_occ": _within(distance, after & ~visible, THRESHOLDS),
        "dynamic_replica_survival": _survival(distance, visible, FAILURE),
    }


def egopoints(
    tracks: FloatArray,
    occluded: BoolArray,
    true: FloatArray,
    valid: BoolArray,
    visible: BoolArray,
    judged: BoolArray,
    out_of_view: BoolArray,
    hidden: BoolArray,
) -> dict[str, float]:
    """EgoPoints' (Darkhalil et al., WACV 2025; `egopoints_eval_cotracker.py`).

    Args:
        tracks: [n, t, 2], the answers.
        occluded: [n, t], the answers.
        true: [n, t, 2].
        valid: [n, t], where the true position is annotated.
        visible: [n, t], the annotated visibility.
        judged: [n, t], where visibility is annotated.
        out_of_view: [n, t], where the point is annotated to lie outside the image.
        hidden: [n, t], where it is annotated to be hidden within.

    Returns:
        egopoints_d_avg, egopoints_d_avg_star: share of the valid points of the frames 1, 2, ... less than D pixels off
            at 256x256, averaged over D in 1, 2, 4, 8, 16 and over D in 8, 16, 24.
        egopoints_re_id: ReID: of the valid points after a track was last out of view, the share less than D pixels off
            at 512x384 among those after it was last out of view and predicted so, averaged over D in 8, 16, 24.
        egopoints_oova: share of the points out of view in frames 1, 2, ... that are predicted outside the image.
        egopoints_iva: share of the points that are valid or hidden in these that are predicted inside.
        egopoints_oa: share of the judged points whose visibility is predicted as it is.
        egopoints_mte: median over a track's valid points, frame 0 included, of the distance, averaged over tracks.
    """
    distance = _distance(tracks, true)
    scale = np.array(INPUT_SIZE) / RASTER_SIZE
    xy, true_xy = tracks * scale, true * scale
    inside = np.asarray(((xy >= 0) & (xy <= INPUT_SIZE)).all(axis=-1))
    lost = out_of_view & ~inside
    lost[:, 0] = False
    back = _after_last(out_of_view) & valid
    found = (_after_last(lost) | _last(lost)) & valid
    near = [
        _share(_distance(xy, true_xy)[:, 1:] < threshold, found[:, 1:], back[:, 1:]) for threshold in FAR_THRESHOLDS
    ]
    in_view = valid.astype(np.int64) + hidden
    return {
        "egopoints_d_avg": _within(distance[:, 1:], valid[:, 1:], THRESHOLDS),
        "egopoints_d_avg_star": _within(distance[:, 1:], valid[:, 1:], FAR_THRESHOLDS),
        "egopoints_re_id": float(np.mean(near)) if out_of_view[:, 1:].any() else np.nan,
        "egopoints_oova": _share(~inside[:, 1:], out_of_view[:, 1:], out_of_view[:, 1:]),
        "egopoints_iva": _share(inside[:, 1:], in_view[:, 1:], in_view[:, 1:]),
        "egopoints_oa": _share(~occluded == visible, judged, judged),
        "egopoints_mte": _median_error(distance, valid),
    }


def badja(tracks: FloatArray, true: FloatArray, counted: BoolArray, areas: FloatArray) -> dict[str, float]:
    """BADJA's percentage of correct keypoints (Biggs et al., ACCV 2018), as PIPs and CoTracker report it.

    Distances and areas are of frames brought to 512x384, as in CoTracker's `Evaluator.compute_metrics`.

    Args:
        tracks: [n, t, 2], the answers.
        true: [n, t, 2].
        counted: [n, t], the visible joints of the frames after the query's.
        areas: [t], pixels of the animal's mask at 512x384.

    Returns:
        badja_pck: share of the counted joints less than 0.2 sqrt(area) off.
        badja_pck_3px: share less than 3 pixels off.
    """
    scale = np.array(INPUT_SIZE) / RASTER_SIZE
    distance = _distance(tracks * scale, true * scale)
    return {
        "badja_pck": _share(distance < PCK_SHARE * np.sqrt(areas), counted, counted),
        "badja_pck_3px": _share(distance < PCK_PIXELS, counted, counted),
    }


def _distance(tracks: FloatArray, true: FloatArray) -> FloatArray:
    return np.linalg.norm(np.subtract(tracks, true, dtype=np.float64), axis=-1)


def _share(right: BoolArray, where: npt.NDArray, of: npt.NDArray) -> float:
    """Of the points `of`, weighed by their values, the share of those right that `where` has."""
    total = np.sum(of)
    return float(np.sum(right * where) / total) if total else np.nan


def _within(distance: FloatArray, where: BoolArray, thresholds: Sequence[float]) -> float:
    return float(np.mean([_share(distance < threshold, where, where) for threshold in thresholds]))


def _survival(distance: FloatArray, where: BoolArray, failure: float) -> float:
    failed = np.logical_or.accumulate((distance > failure) & where, axis=1)
    return float(np.mean(~failed)) if failed.size else np.nan


def _median_error(distance: FloatArray, where: BoolArray) -> float:
    medians = [np.median(far[counted]) for far, counted in zip(distance, where, strict=True) if counted.any()]
    return float(np.mean(medians)) if medians else np.nan


def _last(mask: BoolArray) -> BoolArray:
    """[n, t]: the last True of each row alone."""
    return mask & ~_later(mask)


def _after_last(mask: BoolArray) -> BoolArray:
    """[n, t]: what follows the last True of each row; nothing where a row has none."""
    return mask.any(axis=1, keepdims=True) & ~mask & ~_later(mask)


def _later(mask: BoolArray) -> BoolArray:
    """[n, t]: whether a later frame is True."""
    to_the_end = np.logical_or.accumulate(mask[:, ::-1], axis=1)[:, ::-1]
    return np.concatenate([to_the_end[:, 1:], np.zeros_like(mask[:, :1])], axis=1)
