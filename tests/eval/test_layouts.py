"""What other trackers return, saved as it is, scores as the same answers in our layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decomo_eval.dataset import Video, read_dataset
from decomo_eval.errors import PredictionError
from decomo_eval.layouts import Convention
from decomo_eval.predictions import from_npz
from decomo_eval.tapvid import Queries, pixels_to_raster, sample_queries

SIZES = [(32, 20), (256, 256)]  # of the dataset's stored frames, and TAP-Vid's


@pytest.fixture
def left(dataset: Path) -> tuple[Video, Queries]:
    video = read_dataset(dataset)["left"]
    return video, sample_queries(video, "strided")


def arrays(layout: str, queries: Queries, convention: Convention, size: tuple[int, int]) -> dict[str, Any]:
    """Perfect answers but for their occlusion, which is wrong everywhere; float32 as the trackers'."""
    tracks = convention.from_raster(queries.tracks, size).astype(np.float32)
    xy = convention.from_raster(queries.points[:, :0:-1], size)
    visible = queries.occluded
    txy = np.column_stack([queries.points[:, 0], xy]).astype(np.float32)
    tyx = txy[:, [0, 2, 1]]
    logits = np.where(visible, 3.0, -3.0)
    return {
        "cotracker": {
            "queries": txy[None],
            "pred_tracks": tracks.swapaxes(0, 1)[None],
            "pred_visibility": visible.T[None],
        },
        "tapir": {"query_points": tyx, "tracks": tracks, "visibles": visible},
        "tapir logits": {
            "query_points": tyx[None],
            "tracks": tracks[None],
            "occlusion": -logits[None],
            "expected_dist": np.full_like(logits, -5.0)[None],
        },
        "tapvid": {"query_points": tyx[None], "pred_tracks": tracks[None], "pred_occluded": ~visible[None]},
        "locotrack": {
            "query_points": tyx[None],
            "tracks": tracks[None],
            "occlusion": -logits[None],
            "expected_dist": np.full_like(logits, -5.0)[None],
            "unrefined_tracks": np.zeros((2, *tracks.shape)),
        },
        "track-on": {
            "queries": txy[None],
            "pred_trajectory": tracks.swapaxes(0, 1)[None],
            "pred_visibility": visible.T[None],
        },
        "tapnext": {
            "query_points": tyx[None],
            "tracks": tracks.swapaxes(0, 1)[None, ..., ::-1],
            "track_logits": np.zeros((1, *tracks.shape[1::-1], 6)),
            "visible_logits": logits.T[None, ..., None],
        },
        "pips": {"trajs_e": tracks.swapaxes(0, 1)[None], "vis_e": logits.T[None]},
        "pips probabilities": {"trajs_e": tracks.swapaxes(0, 1), "vis_e": visible.T * 0.8, "queries": txy},
    }[layout]


LAYOUTS = ["cotracker", "track-on", "tapir", "tapir logits", "locotrack", "tapnext", "tapvid"]
LAYOUTS += ["pips", "pips probabilities"]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("convention", Convention)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_and_convention_comes_back_to_the_raster(
    layout: str, convention: Convention, size: tuple[int, int], left: tuple[Video, Queries], tmp_path: Path
) -> None:
    np.savez(tmp_path / "left.npz", **arrays(layout, left[1], convention, size))
    prediction = from_npz(tmp_path / "left.npz", *left)
    np.testing.assert_allclose(prediction.tracks, left[1].tracks, atol=1e-3)  # float32; a small frame is magnified
    np.testing.assert_array_equal(prediction.occluded, ~left[1].occluded, strict=True)
    assert prediction.size == size


def test_centres_are_the_convention_of_the_whole_package() -> None:
    xy = np.array([[3.25, 7.5]])
    np.testing.assert_array_equal(Convention.CENTRES.to_raster(xy, (32, 20)), pixels_to_raster(xy, 32, 20))
    for convention in Convention:
        there = convention.to_raster(xy, (32, 20))
        np.testing.assert_allclose(convention.from_raster(there, (32, 20)), xy, rtol=1e-14)


def test_uncertain_tapir_points_are_hidden(left: tuple[Video, Queries], tmp_path: Path) -> None:
    content = arrays("tapir logits", left[1], Convention.EDGES, (256, 256))
    content["expected_dist"] = np.full_like(content["expected_dist"], 5.0)
    np.savez(tmp_path / "left.npz", **content)
    assert from_npz(tmp_path / "left.npz", *left).occluded.all()


@pytest.mark.parametrize("seen", [0.59, 0.61])
def test_cotracker_s_scores_are_cut_where_its_own_evaluation_does(
    seen: float, left: tuple[Video, Queries], tmp_path: Path
) -> None:
    content = arrays("cotracker", left[1], Convention.CENTRES, (32, 20))
    content["pred_visibility"] = np.full(content["pred_visibility"].shape, seen, np.float32)
    np.savez(tmp_path / "left.npz", **content)
    assert (from_npz(tmp_path / "left.npz", *left).occluded == (seen < 0.6)).all()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("layout", ["cotracker", "track-on", "tapir", "tapnext", "tapvid", "pips probabilities"])
def test_tracks_with_x_and_y_exchanged_are_refused(
    layout: str, size: tuple[int, int], left: tuple[Video, Queries], tmp_path: Path
) -> None:
    content = arrays(layout, left[1], Convention.EDGES, size)
    key = next(key for key in ("tracks", "pred_tracks", "pred_trajectory", "trajs_e") if key in content)
    np.savez(tmp_path / "left.npz", **{**content, key: content[key][..., ::-1]})
    with pytest.raises(PredictionError, match="only with x and y exchanged"):
        from_npz(tmp_path / "left.npz", *left)


@pytest.mark.parametrize(
    ("layout", "change", "words"),
    [
        ("cotracker", {"queries": None}, "lacks the key queries of its layout"),
        ("cotracker", {"pred_tracks": np.zeros((2, 11, 9, 2))}, r"has pred_tracks \[2, 11, 9, 2\]"),
        ("cotracker", {"pred_visibility": np.full((11, 9), np.nan)}, "finite numbers as pred_visibility"),
        ("cotracker", {"width": 500, "height": 500}, "has query 0 at"),
        ("tapir", {"visibles": None}, "lacks the key occluded"),
        ("tapir", {"tracks": np.zeros((3, 11, 2))}, "query, frame"),
        ("tapir", {"visibles": np.full((9, 11), 0.7)}, "true or false as visibles; threshold them"),
        ("cotracker", {"visible_logits": np.zeros((11, 9, 1))}, "CoTracker's, and visible_logits, TAPNext's"),
        ("cotracker", {"pred_trajectory": np.zeros((11, 9, 2))}, "CoTracker's, and pred_trajectory, Track-On's"),
        ("track-on", {"pred_visibility": np.full((11, 9), 0.9)}, "true or false as pred_visibility beside"),
        ("tapnext", {"visible_logits": np.zeros((11, 9))}, r"has visible_logits \[11, 9\]"),
        ("tapnext", {"visible_logits": np.zeros((1, 11, 9))}, r"must be \[T, N, 2\] and \[T, N, 1\]"),
        ("tapnext", {"query_points": None}, "lacks the key query_points"),
        ("pips", {"trajs_e": np.zeros((8, 1, 2)), "vis_e": np.zeros((8, 1))}, "for 8 frames and 1 points"),
    ],
)
def test_what_does_not_fit_is_named(
    layout: str, change: dict[str, Any], words: str, left: tuple[Video, Queries], tmp_path: Path
) -> None:
    content = {**arrays(layout, left[1], Convention.EDGES, (256, 256)), **change}
    np.savez(tmp_path / "left.npz", **{key: value for key, value in content.items() if value is not None})
    with pytest.raises(PredictionError, match=words):
        from_npz(tmp_path / "left.npz", *left)


@pytest.mark.parametrize(
    ("values", "hidden"),
    [
        ([0.3, 0.6], [True, False]),  # probabilities: the half is the limit
        ([-2.0, 0.3], [True, False]),  # logits: 0 is
        ([0.3, 1.5], [False, False]),
    ],
)
def test_pips_scores_are_probabilities_where_all_are_shares(
    values: list[float], hidden: list[bool], left: tuple[Video, Queries], tmp_path: Path
) -> None:
    content = arrays("pips", left[1], Convention.EDGES, (32, 20))
    content["vis_e"] = np.full(content["vis_e"].shape, values[0])
    content["vis_e"][:, 3:] = values[1]
    np.savez(tmp_path / "left.npz", **content)
    occluded = from_npz(tmp_path / "left.npz", *left).occluded
    np.testing.assert_array_equal(occluded, np.tile(np.repeat(hidden, [3, 8]), (len(occluded), 1)))
