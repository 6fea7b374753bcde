"""Which dataset a path holds: the files tell, the user may say, and what belongs to two is refused."""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dataset_files
from decomo_eval.cli import main
from decomo_eval.dataset import chosen_reader, read_dataset
from decomo_eval.errors import DatasetError
from decomo_eval.names import DATASETS
from decomo_eval.predictions import Prediction
from decomo_eval.readers import READERS
from decomo_eval.scoring import evaluate
from decomo_eval.tapvid import Queries, raster_to_pixels, sample_queries
from decomo_eval.video import Video

WRITERS: dict[str, Callable[[Path], Any]] = {
    "pointodyssey": dataset_files.write_pointodyssey,
    "egopoints": dataset_files.write_egopoints,
    "dynamic-replica": dataset_files.write_dynamic_replica,
    "badja": dataset_files.write_badja,
}


def test_the_command_offers_every_reader() -> None:
    assert tuple(READERS) == DATASETS


@pytest.mark.parametrize("name", WRITERS)
def test_the_files_tell(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path)
    assert chosen_reader(tmp_path) is READERS[name] is chosen_reader(tmp_path, name)
    videos = read_dataset(tmp_path)
    (only,) = videos
    video, small = videos[only], read_dataset(tmp_path, "256x256", name)[only]
    assert (video.name, video.width, video.height) == (only, 40, 24)
    assert (~video.occluded).any(axis=1).all()
    assert small.frames().shape == (video.num_frames, 256, 256, 3)
    assert small.figures is not None
    with pytest.raises(DatasetError, match=r"is not of tapvid, which is a pickle, or a folder of \.pkl"):
        read_dataset(tmp_path, name="tapvid")


def test_files_of_two_datasets_are_refused(tmp_path: Path) -> None:
    dataset_files.write_pointodyssey(tmp_path)
    dataset_files.write_egopoints(tmp_path)
    with pytest.raises(DatasetError, match="the files of pointodyssey and of egopoints; say which by --dataset"):
        read_dataset(tmp_path)
    assert list(read_dataset(tmp_path, name="pointodyssey")) == ["r5_new_f"]


def test_pickles_beside_tracks_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({}))
    np.savez(tmp_path / "b.npz")
    with pytest.raises(DatasetError, match="the files of tapvid and of folder"):
        read_dataset(tmp_path)


def test_a_name_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no dataset kubric; choose of tapvid, folder"):
        read_dataset(tmp_path, name="kubric")


@pytest.mark.parametrize("name", WRITERS)
def test_true_answers_are_scored_by_the_command(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    WRITERS[name](tmp_path / "data")
    (tmp_path / "answers").mkdir()
    for video in read_dataset(tmp_path / "data").values():
        queries = sample_queries(video, "first")
        np.savez(
            tmp_path / "answers" / f"{video.name}.npz",
            queries=queries.in_pixels(video.width, video.height),
            tracks=raster_to_pixels(queries.tracks, video.width, video.height),
            occluded=queries.occluded,
        )
    command = ["tapvid", str(tmp_path / "data"), "--predictions", str(tmp_path / "answers")]
    assert main([*command, "--report", str(tmp_path / "report"), "--dataset", name]) == 0
    told = capsys.readouterr().out
    assert "first, mean over 1 of 1 videos: AJ 100.0, < delta_avg 100.0, OA 100.0, TC" in told
    assert "as the benchmark's own code counts: " in told
    page = (tmp_path / "report" / "index.html").read_text()
    assert "As the benchmark's own code counts" in page
    heading, line = (tmp_path / "report" / "tracks.csv").read_text().splitlines()[:2]
    assert len(heading.split(",")) == len(line.split(","))


def test_a_benchmark_s_own_figures_are_of_its_own_queries(tmp_path: Path) -> None:
    dataset_files.write_pointodyssey(tmp_path)

    def truth(video: Video, queries: Queries) -> Prediction:
        return Prediction(queries.tracks, queries.occluded, (video.width, video.height))

    report = evaluate(tmp_path, tracker=truth)
    assert (report.query_mode, report.figures[0]) == ("first", "pointodyssey_d_avg")
    assert report.to_json()["figures"] == list(report.figures)
    strided = evaluate(tmp_path, tracker=truth, query_mode="strided")
    assert strided.figures == ()
    assert not set(report.figures) & set(strided.mean)


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_missing_is_one_sentence_and_code_2(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    WRITERS[name](tmp_path)
    for frames in [*tmp_path.glob("**/rgbs"), *tmp_path.glob("**/images"), *tmp_path.glob("DAVIS/JPEGImages")]:
        shutil.rmtree(frames)
    assert main(["tapvid", str(tmp_path), "--baseline", "chain"]) == 2
    told = capsys.readouterr().err
    assert len(told.strip().splitlines()) == 1
    assert "missing" in told or "cannot be read" in told or "No such file" in told
