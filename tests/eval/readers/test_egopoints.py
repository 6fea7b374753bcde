"""EgoPoints: what is annotated in few frames counts there alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dataset_files import FRAMES, HEIGHT, WIDTH, write_egopoints
from decomo_eval import figures
from decomo_eval.dataset import read_dataset
from decomo_eval.errors import DatasetError
from decomo_eval.measure import score
from decomo_eval.predictions import Prediction
from decomo_eval.tapvid import sample_queries

NAME = "P01_01_start_1_end_13"


def test_a_sequence(tmp_path: Path) -> None:
    truth = write_egopoints(tmp_path)
    video = read_dataset(tmp_path)[NAME]
    annotated = truth["vis_valids"].T > 0
    np.testing.assert_array_equal(video.judged, annotated)
    np.testing.assert_array_equal(~video.occluded, truth["valids"].T > 0)
    np.testing.assert_allclose(video.points * [WIDTH, HEIGHT], truth["trajs_2d"].swapaxes(0, 1), rtol=1e-6)
    assert (sample_queries(video, "first").points[:, 0] == 0).all()


def test_frames_without_annotation_do_not_count(tmp_path: Path) -> None:
    write_egopoints(tmp_path)
    video = read_dataset(tmp_path)[NAME]
    queries = sample_queries(video, "first")
    assert queries.judged is not None
    wrong = ~queries.judged
    answer = Prediction(queries.tracks + 99 * wrong[..., None], queries.occluded ^ wrong, (WIDTH, HEIGHT))
    metrics = score(queries, answer, "first")
    assert metrics["occlusion_accuracy"] == metrics["average_jaccard"] == 1
    assert video.figures is not None
    assert video.figures(answer.tracks, answer.occluded)["egopoints_oa"] == 1


def test_its_own_figures_are_of_its_own_arrays(tmp_path: Path) -> None:
    truth = write_egopoints(tmp_path)
    video = read_dataset(tmp_path)[NAME]
    random = np.random.default_rng(5)
    tracks = video.points * 256 + random.normal(0, 9, video.points.shape)
    occluded = random.random(video.occluded.shape) < 0.3
    flags = {key: array.T > 0 for key, array in truth.items() if key != "trajs_2d"}
    true = truth["trajs_2d"].swapaxes(0, 1) / [WIDTH, HEIGHT] * 256
    assert video.figures is not None
    assert video.figures(tracks, occluded) == pytest.approx(
        figures.egopoints(
            *(tracks, occluded, true, flags["valids"], flags["visibs"], flags["vis_valids"]),
            *(flags["out_of_view"], flags["occluded"]),
        ),
        nan_ok=True,
    )


def test_a_point_is_asked_for_in_frame_0_whatever_its_flags_say(tmp_path: Path) -> None:
    truth = write_egopoints(tmp_path)
    for key in ("visibs", "vis_valids"):
        truth[key][0] = 0
    write_egopoints(tmp_path, **truth)
    video = read_dataset(tmp_path)[NAME]
    assert (~video.occluded[:, 0]).all()
    assert video.judged is not None
    assert video.judged[:, 0].all()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"out_of_view": None}, "lacks the array out_of_view"),
        ({"valids": np.full((FRAMES, 6), np.nan)}, "only true and false in valids"),
        ({"occluded": np.zeros((FRAMES, 7))}, "as many points in each array"),
        ({"trajs_2d": np.full((FRAMES, 6, 2), np.inf)}, "a position in trajs_2d for every point in frame 0"),
        ({"trajs_2d": np.zeros((FRAMES, 6, 1))}, r"trajs_2d \[T, N, 2\]"),
        ({"trajs_2d": np.full((FRAMES, 6, 2), 1e6)}, "as fractions of width and height"),
    ],
)
def test_what_does_not_fit_is_named(changed: dict[str, Any], words: str, tmp_path: Path) -> None:
    write_egopoints(tmp_path, **changed)
    with pytest.raises(DatasetError, match=words):
        read_dataset(tmp_path)[NAME]


def test_a_point_that_is_seen_where_nobody_knows_is_not_judged(tmp_path: Path) -> None:
    """In frame 3 the first is seen at no place, the second at one that is no number, of the third nobody says it."""
    truth = write_egopoints(tmp_path)
    for key in ("valids", "visibs", "vis_valids"):
        truth[key][3, :4] = 1
    truth["valids"][3, 0] = 0
    truth["trajs_2d"][3, 1:4] = [[np.nan, 9], [8, 9], [10, 11]]
    truth["vis_valids"][3, 2] = 0
    write_egopoints(tmp_path, **truth)
    video = read_dataset(tmp_path)[NAME]
    assert video.judged is not None
    assert video.judged[:4, 3].tolist() == [False, False, False, True]
    assert video.occluded[:4, 3].tolist() == [True, True, True, False]
    assert video.figures is not None
    off = video.points * 256
    off[:3, 3] += 300  # counts of the third alone, whose place is known
    exact = video.figures(video.points * 256, video.occluded)["egopoints_d_avg"]
    counted = (truth["valids"][1:] > 0).sum() - 1
    assert exact == 1
    assert video.figures(off, video.occluded)["egopoints_d_avg"] == pytest.approx(1 - 1 / counted)
