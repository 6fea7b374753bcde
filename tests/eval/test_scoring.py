"""From files to a report."""

from __future__ import annotations

import json
import math
import pickle
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import decomo_eval
from decomo_eval import evaluate
from decomo_eval.dataset import read_dataset
from decomo_eval.errors import DatasetError, EvalError, PredictionError
from decomo_eval.measure import IN_PIXELS, score, score_tracks
from decomo_eval.predictions import Prediction
from decomo_eval.scoring import Scored
from decomo_eval.tapvid import sample_queries
from decomotion.windows import FILE_NAME, Window, Windows

WritePredictions = Callable[..., Path]


def assert_perfect(metrics: Any) -> None:
    for name, value in metrics.items():
        # float32 positions of up to 256
        assert value == (pytest.approx(0, abs=1e-4) if name in IN_PIXELS else 1), name


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_perfect_predictions_are_perfect(dataset: Path, write_predictions: WritePredictions, query_mode: str) -> None:
    folder = write_predictions("left", "right", query_mode=query_mode)
    report = evaluate(dataset, predictions=folder, query_mode=query_mode)
    assert list(report.videos) == ["left", "right"]
    assert_perfect(report.videos["left"])
    assert_perfect(report.mean)
    assert report.missing == ()
    assert report.undefined == {}


def test_the_mean_is_over_videos(dataset: Path, write_predictions: WritePredictions) -> None:
    folder = write_predictions("left", "right")
    queries = sample_queries(read_dataset(dataset)["right"], "strided")
    write_predictions("right", occluded=~queries.occluded)
    report = evaluate(dataset, predictions=folder)
    assert report.videos["left"]["occlusion_accuracy"] == 1
    assert report.videos["right"]["occlusion_accuracy"] == 0
    assert report.mean["occlusion_accuracy"] == 0.5
    assert report.mean["average_pts_within_thresh"] == 1


def test_absent_videos_are_named_and_left_out(dataset: Path, write_predictions: WritePredictions) -> None:
    report = evaluate(dataset, predictions=write_predictions("right"))
    assert list(report.videos) == ["right"]
    assert report.missing == ("left",)
    assert report.to_json()["missing"] == ["left"]


def test_a_requested_video_must_be_there(dataset: Path, write_predictions: WritePredictions) -> None:
    folder = write_predictions("right")
    assert list(evaluate(dataset, predictions=folder, videos=["right"]).videos) == ["right"]
    assert evaluate(dataset, predictions=folder, videos=["right"]).missing == ()
    with pytest.raises(PredictionError, match=r"has no left.npz; it must hold <video>.npz"):
        evaluate(dataset, predictions=folder, videos=["right", "left"])
    with pytest.raises(DatasetError, match="has no video up, down; it has left, right"):
        evaluate(dataset, predictions=folder, videos=["up", "left", "down"])
    with pytest.raises(DatasetError, match="no video is named"):
        evaluate(dataset, predictions=folder, videos=[])


def test_a_video_that_is_named_twice_is_scored_once(dataset: Path, write_predictions: WritePredictions) -> None:
    seen: list[str] = []
    report = evaluate(
        dataset,
        predictions=write_predictions("left", "right"),
        videos=["right", "left", "right"],
        watch=lambda scored: seen.append(scored.video.name),
    )
    assert seen == list(report.videos) == ["right", "left"]


def test_of_a_thousand_videos_some_are_named(
    dataset: Path, dataset_content: dict[str, Any], write_predictions: WritePredictions
) -> None:
    folder = write_predictions("left")
    dataset.write_bytes(pickle.dumps({f"v{number:03}": dataset_content["left"] for number in range(200)}))
    with pytest.raises(PredictionError, match=r"has no v000.npz, .*, v007.npz and 192 more; it must hold"):
        evaluate(dataset, predictions=folder)
    with pytest.raises(DatasetError, match=r"has no video up; it has v000, .*, v007 and 192 more$"):
        evaluate(dataset, predictions=folder, videos=["up"])


def test_a_folder_without_any_video_is_an_error(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(PredictionError, match=r"has no left.onnx, right.onnx"):
        evaluate(dataset, models=tmp_path)
    with pytest.raises(PredictionError, match=r"nowhere has no left.npz"):
        evaluate(dataset, predictions=tmp_path / "nowhere")


def test_the_two_resolutions_are_not_averaged(dataset: Path, write_predictions: WritePredictions) -> None:
    folder = write_predictions("left", size=(256, 256))
    assert evaluate(dataset, predictions=folder).resolution == "256x256"
    write_predictions("right")
    assert evaluate(dataset, predictions=folder, videos=["right"]).resolution == "original"
    with pytest.raises(PredictionError, match="left was tracked at 256x256 but right at another size"):
        evaluate(dataset, predictions=folder)


def test_a_video_stored_at_256_is_in_both_categories(
    dataset: Path, dataset_content: dict[str, Any], write_predictions: WritePredictions
) -> None:
    dataset_content["left"]["video"] = np.zeros((11, 256, 256, 3), np.uint8)
    dataset.write_bytes(pickle.dumps(dataset_content))
    folder = write_predictions("left", size=(256, 256))
    assert evaluate(dataset, predictions=folder).resolution == "256x256"
    write_predictions("right")
    assert evaluate(dataset, predictions=folder).resolution == "original"
    write_predictions("right", size=(256, 256))
    assert evaluate(dataset, predictions=folder).resolution == "256x256"


def test_a_tracker_sees_frames_of_the_resolution_asked_for(dataset: Path) -> None:
    sizes = []

    def watching(video: Any, queries: Any) -> Prediction:
        sizes.append(video.frames().shape)
        return still(video, queries)

    assert evaluate(dataset, tracker=watching, resolution="256x256").resolution == "256x256"
    assert evaluate(dataset, tracker=watching).resolution == "original"
    assert sizes == [(11, 256, 256, 3)] * 2 + [(11, 20, 32, 3)] * 2


def still(video: Any, queries: Any) -> Prediction:
    """Every point stays where it was asked for."""
    tracks = np.repeat(queries.points[:, None, :0:-1], queries.occluded.shape[1], axis=1)
    return Prediction(tracks, np.zeros_like(queries.occluded), (video.width, video.height))


def test_a_function_is_a_tracker_and_is_watched(dataset: Path) -> None:
    seen: list[Scored] = []
    report = evaluate(dataset, tracker=still, watch=seen.append)
    assert report.tracker == "still"
    assert [scored.video.name for scored in seen] == ["left", "right"]
    assert [scored.metrics for scored in seen] == list(report.videos.values())
    low, high = report.interval["average_jaccard"]
    values = [metrics["average_jaccard"] for metrics in report.videos.values()]
    assert min(values) <= low < report.mean["average_jaccard"] < high <= max(values)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tracks, occluded: (tracks[1:], occluded[1:]), "still on video left has tracks"),
        (lambda tracks, occluded: (tracks * np.nan, occluded), "no finite position for query 0 in frame 0"),
        (lambda tracks, occluded: (tracks, occluded + 0.3), "true or false as occluded"),
    ],
)
def test_a_function_s_answers_are_checked(dataset: Path, change: Callable[..., Any], words: str) -> None:
    def wrong(video: Any, queries: Any) -> Prediction:
        answer = still(video, queries)
        return Prediction(*change(answer.tracks, answer.occluded), answer.size)

    wrong.__name__ = "still"
    with pytest.raises(PredictionError, match=words):
        evaluate(dataset, tracker=wrong)


def test_a_function_that_exchanges_x_and_y_is_named(dataset: Path) -> None:
    def exchanged(video: Any, queries: Any) -> Prediction:
        points = queries.in_pixels(video.width, video.height)
        tracks = np.repeat(points[:, None, :0:-1], video.num_frames, axis=1)
        return Prediction.from_pixels(tracks, queries.occluded, video.width, video.height)

    with pytest.raises(PredictionError, match="exchanged on video left has tracks that lie at their queries only"):
        evaluate(dataset, tracker=exchanged)


def test_one_video_is_in_memory_at_a_time(tmp_path: Path) -> None:
    """Of a folder, with the report's writer looking on: six videos need what two need."""
    from decomo_eval.report.writer import ReportWriter

    size, frames = 320, 8  # so large that the plots, which grow with the videos, do not count
    rng = np.random.default_rng(0)
    for name in "abcdef":
        (tmp_path / "all" / name).mkdir(parents=True)
        for number in range(frames):
            noise = rng.integers(0, 256, (size, size, 3), dtype=np.uint8)  # does not compress
            cv2.imwrite(str(tmp_path / "all" / name / f"{number}.png"), noise)
        tracks = rng.uniform(10, 100, (400, 1, 2)) + np.zeros((1, frames, 1))
        np.savez(tmp_path / "all" / f"{name}.npz", tracks=tracks, occluded=np.zeros((400, frames), bool))

    def peak(videos: str) -> int:
        tracemalloc.start()
        try:
            with ReportWriter(tmp_path / "report", "strided") as writer:
                writer.write(evaluate(tmp_path / "all", tracker=still, videos=list(videos), watch=writer.see))
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak("a")  # loads what is loaded once
    assert peak("abcdef") < 1.2 * peak("ab")


def test_splits_are_means_over_videos_and_counts_are_added(dataset: Path, tmp_path: Path) -> None:
    everywhere = np.ones((11, 5, 8), bool)
    np.savez(tmp_path / "masks.npz", left=everywhere, right=everywhere)
    splits = evaluate(dataset, tracker=still, object_masks=tmp_path / "masks.npz").splits
    assert set(splits) == {"dynamic", "visible", "reappeared", "out_of_frame"}
    alone = [evaluate(dataset, tracker=still, videos=[name]) for name in ("left", "right")]
    each = [scores.mean["average_jaccard"] for scores in alone]
    assert each[0] != each[1]
    assert splits["dynamic"]["average_jaccard"] == pytest.approx(np.mean(each))
    assert splits["visible"]["count"] == sum(scores.splits["visible"]["count"] for scores in alone) > 0


def test_a_video_without_a_mask_is_left_out_of_its_split(dataset: Path, tmp_path: Path) -> None:
    np.savez(tmp_path / "masks.npz", left=np.ones((11, 5, 8), bool))
    report = evaluate(dataset, tracker=still, object_masks=tmp_path / "masks.npz")
    alone = evaluate(dataset, tracker=still, videos=["left"])
    assert report.splits["dynamic"]["average_jaccard"] == alone.mean["average_jaccard"]
    assert report.to_json()["without_masks"] == ["right"]
    with pytest.raises(DatasetError, match="has masks of left, but of no video that is scored"):
        evaluate(dataset, tracker=still, videos=["right"], object_masks=tmp_path / "masks.npz")


def test_object_masks_are_read_when_their_video_is_scored(dataset: Path, tmp_path: Path) -> None:
    np.savez(tmp_path / "masks.npz", left=np.ones((11, 5, 8), bool), right=np.ones((11, 5, 8)))  # no mask
    watched: list[Scored] = []
    with pytest.raises(DatasetError, match="booleans or whole numbers"):
        evaluate(dataset, tracker=still, object_masks=tmp_path / "masks.npz", watch=watched.append)
    assert [scored.video.name for scored in watched] == ["left"]


def test_tracks_are_scored_one_by_one(dataset: Path) -> None:
    queries = sample_queries(read_dataset(dataset)["left"], "strided")
    video = read_dataset(dataset)["left"]
    tracks = score_tracks(queries, still(video, queries), "strided")
    alone = type(queries)(queries.points[[3]], queries.tracks[[3]], queries.occluded[[3]])
    for name, value in score(alone, still(video, alone), "strided").items():
        np.testing.assert_equal(tracks[name][3], value)
        assert tracks[name].shape == (len(queries.points),)


def test_exactly_one_source_is_needed(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(EvalError, match="either"):
        evaluate(dataset)
    with pytest.raises(EvalError, match="either"):
        evaluate(dataset, models=tmp_path, predictions=tmp_path)
    with pytest.raises(EvalError, match="strided, first"):
        evaluate(dataset, models=tmp_path, query_mode="dense")


def test_a_video_without_visible_point_is_named_and_does_not_spoil_the_mean(
    dataset: Path, dataset_content: dict[str, Any], write_predictions: WritePredictions
) -> None:
    # Visible in frame 0 alone, where the queries are: nothing to score but occlusion.
    dataset_content["left"]["occluded"][:, 1:] = True
    dataset.write_bytes(pickle.dumps(dataset_content))
    report = evaluate(dataset, predictions=write_predictions("left", "right"))
    assert math.isnan(report.videos["left"]["average_jaccard"])
    assert report.videos["left"]["occlusion_accuracy"] == 1
    assert_perfect(report.mean)
    assert list(report.undefined) == ["left"]
    assert "average_jaccard" in report.undefined["left"]
    assert "occlusion_accuracy" not in report.undefined["left"]
    written = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert written["videos"]["left"]["average_jaccard"] is None
    assert written["mean"]["average_jaccard"] == 1


def test_the_mean_of_nothing_is_undefined(
    dataset: Path, dataset_content: dict[str, Any], write_predictions: WritePredictions
) -> None:
    dataset_content["left"]["occluded"][:] = True
    dataset.write_bytes(pickle.dumps(dataset_content))
    report = evaluate(dataset, predictions=write_predictions("left", "right"), videos=["left"])
    assert all(math.isnan(value) for value in report.mean.values())
    assert set(report.to_json()["mean"].values()) == {None}


def test_a_video_without_queries_is_of_no_resolution(
    dataset: Path, dataset_content: dict[str, Any], write_predictions: WritePredictions
) -> None:
    dataset_content["left"]["occluded"][:] = True
    dataset.write_bytes(pickle.dumps(dataset_content))
    write_predictions("right", size=(256, 256))
    assert evaluate(dataset, predictions=write_predictions("left")).resolution == "256x256"


def test_a_model_is_asked_and_scored(dataset: Path, dataset_content: dict[str, Any], tmp_path: Path) -> None:
    """The tiny model moves every point by one velocity in its own pixels, of 854x480 where the dataset stores 32x20."""
    pytest.importorskip("onnx", reason="onnx writes the model; scoring needs onnxruntime only")
    from tiny_model import VELOCITY, write_tiny_model

    elapsed = np.arange(11)
    for name, entry in dataset_content.items():
        velocity = np.array(VELOCITY) / [854, 480]
        entry["points"] = entry["points"][:, :1] + elapsed[:, None] * velocity
        entry["occluded"] = np.repeat([elapsed / 11 > 0.5], len(entry["points"]), axis=0)
        write_tiny_model(tmp_path / f"{name}.onnx", num_frames=11, width=854, height=480, clip_name=name)
    dataset.write_bytes(pickle.dumps(dataset_content))
    # Queries in frame 0, from which the model counts its occlusion.
    assert_perfect(evaluate(dataset, models=tmp_path, query_mode="first").mean)
    for name in dataset_content:  # as a folder of one window
        (tmp_path / name).mkdir()
        (tmp_path / f"{name}.onnx").rename(tmp_path / name / "window-000.onnx")
        Windows(name, 11, 480, 854, 12.5, (Window("window-000", 0, 11),)).save(tmp_path / name / FILE_NAME)
    assert_perfect(evaluate(dataset, models=tmp_path, query_mode="first").mean)


def test_still_points_on_real_video(shared: Path, tmp_path: Path) -> None:
    """First 32 frames of three DAVIS clips: the points that move least are the easiest for a tracker of no motion."""
    data = shared / "data" / "tapvid_davis32_dev.pkl"
    names = ["goat", "camel", "car-shadow"]
    videos = read_dataset(data)
    for name in names:
        video = videos[name]
        assert (video.num_frames, video.height, video.width) == (32, 256, 256)
        queries = sample_queries(video, "first").in_pixels(256, 256)
        np.savez(
            tmp_path / f"{name}.npz",
            queries=queries,
            tracks=np.repeat(queries[:, None, 1:], 32, axis=1),
            occluded=np.zeros((len(queries), 32), bool),
        )
    report = evaluate(data, predictions=tmp_path, query_mode="first")
    assert list(report.videos) == names
    assert len(report.missing) == 7
    for name in names:
        truth = sample_queries(videos[name], "first")
        after = np.arange(32) > truth.points[:, :1]
        # A tracker that says "visible" everywhere is right as often as points are visible.
        assert report.videos[name]["occlusion_accuracy"] == (~truth.occluded)[after].mean()
        assert 0 < report.videos[name]["average_jaccard"] < report.videos[name]["average_pts_within_thresh"] < 1
    assert videos["goat"].frames().shape == (32, 256, 256, 3)


def test_a_tracker_s_answers_saved_as_the_page_says_score_as_the_function(dataset: Path, tmp_path: Path) -> None:
    """docs/scoring.md, step 2, both ways."""
    for name, video in decomo_eval.read_dataset(dataset).items():
        queries = decomo_eval.sample_queries(video, "strided").in_pixels(video.width, video.height)
        tracks = np.repeat(queries[:, None, 1:], video.num_frames, axis=1)
        occluded = np.zeros(tracks.shape[:2], bool)
        np.savez(tmp_path / f"{name}.npz", queries=queries, tracks=tracks, occluded=occluded)

    def yours(video: Any, queries: Any) -> Prediction:
        points = queries.in_pixels(video.width, video.height)
        tracks = np.repeat(points[:, None, 1:], video.num_frames, axis=1)
        return Prediction.from_pixels(tracks, np.zeros(tracks.shape[:2], bool), video.width, video.height)

    by_files, by_function = evaluate(dataset, predictions=tmp_path).mean, evaluate(dataset, tracker=yours).mean
    for name, value in by_function.items():
        assert value == pytest.approx(evaluate(dataset, tracker=still).mean[name], rel=1e-4), name
        assert by_files[name] == pytest.approx(value, rel=1e-4), name  # float32 queries
