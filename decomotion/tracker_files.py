"""What other trackers' code returns, saved as it is under its own names: the one place that knows these layouts.

layout      keys and shapes                                                              from
CoTracker   pred_tracks [T, N, 2] (x, y), pred_visibility [T, N]; queries [N, 3]         `CoTrackerPredictor`
            (t, x, y). Pixel centres at integers
Track-On    pred_trajectory in the place of pred_tracks; pred_visibility is bool         Track-On's `Predictor`
TAPNet      query_points [N, 3] (t, y, x), tracks [N, T, 2] (x, y), and one of           TAPIR, BootsTAPIR, LocoTrack
            visibles [N, T] | occlusion [N, T] with or without expected_dist [N, T], logits | occluded [N, T];
            pred_tracks and pred_occluded, as `compute_tapvid_metrics` takes them, in their places. The image spans
            0 to W and 0 to H
TAPNext     query_points [N, 3] (t, y, x), tracks [T, N, 2] (y, x), visible_logits       TAPNext, TAPNext++ (torch)
            [T, N, 1]. The image spans 0 to W and 0 to H

A leading axis of one video is dropped. The names alone tell the layout; values are checked by who reads the file.
All functions take `where`, which begins their messages, and the arrays by key, and raise `error` where a key is missing
or an array has not as many axes as its layout says.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.errors import InputError

COTRACKER_VISIBLE = 0.6
"""Visibility above which CoTracker's own evaluation takes a point for visible (its `Evaluator.compute_metrics`)."""

Arrays = Mapping[str, npt.NDArray[Any]]


KEYS = frozenset(
    [
        *("queries", "pred_tracks", "pred_visibility", "pred_trajectory", "query_points", "tracks", "visible_logits"),
        *("visibles", "occlusion", "expected_dist", "occluded", "pred_occluded"),
    ]
)
"""All keys of these layouts."""


def is_tapnet(content: Arrays) -> bool:
    """Whether these are the names of TAPNet's layout or TAPNext's, whose pixels begin at the image's edge."""
    return "query_points" in content or _is_tapnext(content)


def _is_tapnext(content: Arrays) -> bool:
    return "visible_logits" in content


def unpacked(where: str, content: Arrays, error: type[InputError]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]] | None:
    """Tracks [N, T, 2], (x, y), and occluded [N, T]; None where the names are of none of these layouts."""
    if "pred_visibility" in content:
        if _is_tapnext(content):
            raise error(
                f"{where} has pred_visibility, CoTracker's, and visible_logits, TAPNext's; leave one of them out"
            )
        return _cotracker(where, content, error)
    if _is_tapnext(content):
        return _tapnext(where, content, error)
    return _tapnet(where, content, error) if is_tapnet(content) else None


def asked_points(where: str, content: Arrays, error: type[InputError]) -> npt.NDArray[Any]:
    """[N, 3], (t, x, y): of `queries`, or of TAPNet's `query_points`."""
    if not is_tapnet(content):
        return of_one_video(where, content, "queries", 2, error)
    points = of_one_video(where, content, "query_points", 2, error)  # (t, y, x)
    return np.concatenate([points[:, :1], points[:, :0:-1]], axis=1)


def _cotracker(where: str, content: Arrays, error: type[InputError]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    visibility = scores(where, content, "pred_visibility", 2, error)
    key = "pred_tracks"
    if "pred_trajectory" in content:
        if key in content:
            raise error(f"{where} has {key}, CoTracker's, and pred_trajectory, Track-On's; leave one of them out")
        key = "pred_trajectory"
        if not np.isin(visibility, (0, 1)).all():
            raise error(f"{where} must hold true or false as pred_visibility beside pred_trajectory, Track-On's")
    tracks = np.swapaxes(of_one_video(where, content, key, 3, error), 0, 1)
    return tracks, ~(visibility if visibility.dtype == bool else visibility > COTRACKER_VISIBLE).T


def _tapnext(where: str, content: Arrays, error: type[InputError]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    logits = scores(where, content, "visible_logits", 3, error)
    tracks = of_one_video(where, content, "tracks", 3, error)
    if logits.shape[2] != 1 or tracks.shape[2] != 2:
        raise error(
            f"{where} has tracks {list(tracks.shape)} and visible_logits {list(logits.shape)}; they must be "
            "[T, N, 2] and [T, N, 1], as TAPNext returns them"
        )
    return np.swapaxes(tracks, 0, 1)[..., ::-1], ~(logits[..., 0] > 0).T


def _tapnet(where: str, content: Arrays, error: type[InputError]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    key = "pred_tracks" if "pred_tracks" in content else "tracks"
    return of_one_video(where, content, key, 3, error), _tapnet_occluded(where, content, error)


def _tapnet_occluded(where: str, content: Arrays, error: type[InputError]) -> npt.NDArray[Any]:
    """TAPIR's rule (Doersch et al. 2023): visible where (1 - occlusion) (1 - uncertainty) passes 0.5."""
    if "occlusion" in content:
        visible = 1 - _sigmoid(scores(where, content, "occlusion", 2, error))
        if "expected_dist" in content:
            certain = 1 - _sigmoid(scores(where, content, "expected_dist", 2, error))
            if certain.shape != visible.shape:
                raise error(
                    f"{where} has occlusion {list(visible.shape)} and expected_dist {list(certain.shape)}; "
                    "both must be [N, T]"
                )
            visible = visible * certain
        return ~(visible > 0.5)
    if "visibles" in content:
        visibles = of_one_video(where, content, "visibles", 2, error)
        if visibles.dtype.kind not in "biuf" or not np.isin(visibles, (0, 1)).all():
            raise error(
                f"{where} must hold true or false as visibles; threshold them, or save TAPIR's logits as occlusion and "
                "expected_dist"
            )
        return visibles == 0
    return of_one_video(where, content, "pred_occluded" if "pred_occluded" in content else "occluded", 2, error)


def of_one_video(where: str, content: Arrays, key: str, axes: int, error: type[InputError]) -> npt.NDArray[Any]:
    """An array of that many axes, a leading axis of one video dropped."""
    if key not in content:
        raise error(f"{where} lacks the key {key} of its layout; docs/formats-scoring.md has the layouts")
    array = content[key]
    if array.ndim == axes + 1 and len(array) == 1:
        array = array[0]
    if array.ndim != axes:
        raise error(f"{where} has {key} {list(content[key].shape)}; docs/formats-scoring.md has the shapes")
    return array


def scores(where: str, content: Arrays, key: str, axes: int, error: type[InputError]) -> npt.NDArray[Any]:
    """The same of finite numbers."""
    array = of_one_video(where, content, key, axes, error)
    if array.dtype.kind not in "biuf" or not np.isfinite(array).all():
        raise error(f"{where} must hold finite numbers as {key}")
    return array


def _sigmoid(logits: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    return 0.5 * (1 + np.tanh(0.5 * logits.astype(np.float64)))
