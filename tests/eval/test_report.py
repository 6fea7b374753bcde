"""The report's folder: one page that needs nothing beside it, and the same numbers in other forms."""

from __future__ import annotations

import base64
import csv
import json
import math
import pickle
import re
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import av
import cv2
import matplotlib
import numpy as np
import pytest

from decomo_eval.cli import main
from decomo_eval.dataset import read_dataset
from decomo_eval.measure import score
from decomo_eval.predictions import Prediction
from decomo_eval.report.charts import MOST_BARS, error_over_time, threshold_curves, video_bars
from decomo_eval.report.clips import CLIPS, FALSE, FOUND, LOST, WorstClips, draw
from decomo_eval.report.films import side_by_side
from decomo_eval.report.plots import mean_over_videos, median_error_by_gap
from decomo_eval.report.published import published
from decomo_eval.report.tables import latex_row
from decomo_eval.scoring import Scored, evaluate
from decomo_eval.tapvid import Queries, sample_queries

WritePredictions = Callable[..., Path]


VOID = ("meta", "img", "br")
"""Elements without an end."""


class Page(HTMLParser):
    """Checks that tags are closed in order, and collects what the page would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.loaded += [
            value or "" for key, value in attrs if key in ("src", "xlink:href") or (tag, key) == ("link", "href")
        ]
        assert tag != "script"

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag


@pytest.fixture
def folder(dataset: Path, dataset_content: dict[str, Any], write_predictions: WritePredictions, tmp_path: Path) -> Path:
    """Of a dataset with a name that is not HTML, a video that is missing, and one without a visible point to count."""
    entries = {"<b>left": dataset_content["left"], "right": dataset_content["right"], "absent": dataset_content["left"]}
    entries["right"]["occluded"][:, 1:] = True
    dataset.write_bytes(pickle.dumps(entries))
    answers = write_predictions("<b>left", "right")
    command = ["tapvid", str(dataset), "--predictions", str(answers), "--report", str(tmp_path / "report")]
    assert main(command) == 0
    return tmp_path / "report"


def test_the_page_stands_alone_and_says_what_was_left_out(folder: Path) -> None:
    text = (folder / "index.html").read_text()
    page = Page(text)
    kinds = [source.split(",")[0] for source in page.loaded]
    assert kinds == [*["data:image/svg+xml;base64"] * 3, "data:image/jpeg;base64"]  # of two videos one has no Jaccard
    assert "&lt;b&gt;left" in text
    assert "<b>left" not in text
    plain = re.sub(r"\s+", " ", text)
    assert "Not scored, no file (1):</b> absent" in plain
    assert "no point to count (1):</b> right" in plain
    measured, apart = text.split("Published figures, not measured here")
    assert "OmniMotion" in apart
    assert "OmniMotion" not in measured
    assert sorted(file.name for file in folder.iterdir()) == [
        *("index.html", "row.tex", "scores.json", "tracks.csv", "videos.csv")
    ]


def test_csv_and_json_hold_the_same_numbers(folder: Path, dataset: Path) -> None:
    scores = json.loads((folder / "scores.json").read_text())
    videos = {row.pop("video"): row for row in csv.DictReader((folder / "videos.csv").read_text().splitlines())}
    assert list(videos) == ["<b>left", "right", "mean", "low", "high"]
    for name, row in videos.items():
        if name in scores["videos"]:
            for metric, value in scores["videos"][name].items():
                assert row[metric] == ("" if value is None else f"{value:.6g}")
    tracks = list(csv.DictReader((folder / "tracks.csv").read_text().splitlines()))
    video = read_dataset(dataset)["<b>left"]
    queries = sample_queries(video, "strided")
    left = [row for row in tracks if row["video"] == "<b>left"]
    assert len(left) == len(queries.points)
    np.testing.assert_allclose([float(row["y"]) for row in left], queries.points[:, 1], atol=1e-3)
    assert {row["average_jaccard"] for row in left} == {"1"}


def test_a_failed_evaluation_leaves_the_former_report(folder: Path, dataset: Path, tmp_path: Path) -> None:
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    np.savez(tmp_path / "predictions" / "right.npz", queries=np.zeros((1, 3)))
    command = ["tapvid", str(dataset), "--predictions", str(tmp_path / "predictions"), "--report", str(folder)]
    assert main(command) == 2
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_the_latex_row(dataset: Path, write_predictions: WritePredictions) -> None:
    folder = write_predictions("left", "right")
    other = folder.rename(folder.parent / "my_tracker&co")
    comment, row = latex_row(evaluate(dataset, predictions=other)).splitlines()
    assert row == r"my\_tracker\&co & 100.0 & 100.0 & 100.0 & 0.00 \\"
    assert comment.startswith("% strided, 2 videos: Method & AJ")


SVG = "{http://www.w3.org/2000/svg}"


def drawn(svg: str, gid: str) -> list[list[tuple[float, float]]]:
    """The corners, in points, of each path within what has this id."""
    paths = [
        group.find(f"{SVG}path") for group in ElementTree.fromstring(svg).iter(f"{SVG}g") if group.get("id") == gid
    ]
    assert None not in paths
    texts = [path.get("d") or "" for path in paths if path is not None]
    return [[(float(x), float(y)) for x, y in re.findall(r"[ML] (\S+) (\S+)", text)] for text in texts]


def texts(svg: str) -> list[str]:
    return [text.text or "" for text in ElementTree.fromstring(svg).iter(f"{SVG}text")]


def test_bars_are_by_size_and_leave_out_what_is_undefined() -> None:
    bars = video_bars({"<a> $x$": 0.5, "b": math.nan, "c": 0.25, "名": 0.75}, 0.5, "by & by")
    lengths = [path[1][0] - path[0][0] for path in drawn(bars, "bars")]
    assert lengths == pytest.approx([lengths[0], 2 * lengths[0], 3 * lengths[0]])
    assert [text for text in texts(bars) if text in ("<a> $x$", "b", "c", "名")] == ["c", "<a> $x$", "名"]
    assert {"25.0", "50.0", "75.0", "mean 50.0"} <= set(texts(bars))
    assert len(drawn(video_bars({str(n): n / 100 for n in range(99)}, math.nan, "many"), "bars")) == MOST_BARS
    assert drawn(video_bars({}, math.nan, "none"), "bars") == []


def test_curves_of_what_is_defined() -> None:
    metrics = {
        f"{kind}_{x}": (math.nan if kind == "jaccard" else 0.5)
        for kind in ("pts_within", "jaccard")
        for x in (1, 2, 4, 8, 16)
    }
    curves = threshold_curves(metrics, "curves")
    (curve,) = drawn(curves, "pts_within")
    assert np.diff(np.array(curve), axis=0) == pytest.approx(np.array([[curve[1][0] - curve[0][0], 0]] * 4), abs=1e-3)
    assert drawn(curves, "jaccard") == []
    assert [text for text in texts(curves) if text.startswith(("within", "Jaccard"))] == ["within 50.0"]


def test_error_over_time_leaves_out_what_is_undefined() -> None:
    (line,) = drawn(error_over_time([math.nan, 1, math.nan, 3], "over time"), "error")
    assert len(line) == 2
    assert line[0][1] > line[1][1]  # larger is higher
    nothing = error_over_time([math.nan, math.nan], "nothing to show")
    assert drawn(nothing, "error") == []


def test_drawing_changes_no_setting_of_matplotlib() -> None:
    before = dict(matplotlib.rcParams)
    first = error_over_time([0, 1], "twice")
    assert error_over_time([0, 1], "twice") == first  # no date, no chance
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("library", ["matplotlib", "jinja2", "yaml"])
@pytest.mark.parametrize("option", ["--report", "--plots"])
def test_without_a_library_of_reports_the_extra_is_named_before_anything_is_scored(
    dataset: Path,
    write_predictions: WritePredictions,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    option: str,
    library: str,
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    command = ["tapvid", str(dataset), "--predictions", str(write_predictions("left", "right"))]
    assert main([*command, option, str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    assert printed.err == f"Error: reports and plots need {library}; run: pip install 'decomotion[report]'\n"
    assert printed.out == ""
    assert not (tmp_path / "out").exists()


def test_error_over_time_by_hand(dataset: Path) -> None:
    """One point asked for in frame 2 of 5; it drifts by its distance in time, and is hidden in frame 4."""
    frame = np.arange(5)
    tracks = np.zeros((1, 5, 2))
    drifted = tracks + np.abs(frame - 2)[None, :, None] * [3, 4]
    occluded = np.zeros((1, 5), bool)
    occluded[0, 4] = True
    queries = Queries(np.array([[2.0, 0, 0]]), tracks, occluded)
    one = Scored(read_dataset(dataset)["left"], queries, Prediction(drifted, occluded, (32, 20)), {})
    for mode, expected in (("strided", [math.nan, 5, 10]), ("first", [math.nan, 5, math.nan])):
        np.testing.assert_array_equal(median_error_by_gap(one, mode), [*expected, math.nan, math.nan])
    nothing = Scored(one.video, queries.chosen(np.zeros(1, bool)), Prediction(tracks[:0], occluded[:0], (32, 20)), {})
    assert np.isnan(median_error_by_gap(nothing, "first")).all()
    hidden = Scored(one.video, Queries(queries.points, tracks, ~occluded), one.prediction, {})
    np.testing.assert_array_equal(median_error_by_gap(hidden, "strided"), [math.nan, math.nan, 10, math.nan, math.nan])
    both = mean_over_videos([np.array([1.0, math.nan]), np.array([3.0, math.nan, 5])])
    np.testing.assert_array_equal(both, [2, math.nan, 5])


def test_plots_alone_are_svg_files(dataset: Path, write_predictions: WritePredictions, tmp_path: Path) -> None:
    command = ["tapvid", str(dataset), "--predictions", str(write_predictions("left", "right"))]
    assert main([*command, "--plots", str(tmp_path / "plots"), "--report", str(tmp_path / "report")]) == 0
    page = Page((tmp_path / "report" / "index.html").read_text())
    files = sorted((tmp_path / "plots").iterdir())
    assert [file.name for file in files] == ["thresholds.svg", "time.svg", "videos.svg"]
    for file in files:
        assert ElementTree.parse(file).getroot().tag == f"{SVG}svg"
        assert any(source.endswith(base64.b64encode(file.read_bytes()).decode()) for source in page.loaded)


def test_a_film_of_a_video_without_a_name(
    dataset: Path, dataset_content: dict[str, Any], write_predictions: WritePredictions, tmp_path: Path
) -> None:
    folder = write_predictions("left")
    (folder / "left.npz").rename(folder / ".npz")
    dataset.write_bytes(pickle.dumps({"": dataset_content["left"]}))
    command = ["tapvid", str(dataset), "--predictions", str(folder)]
    assert main([*command, "--overlay", str(tmp_path / "films")]) == 0
    assert [file.name for file in (tmp_path / "films").iterdir()] == ["video.mp4"]


def test_films_show_prediction_and_truth(dataset: Path, write_predictions: WritePredictions, tmp_path: Path) -> None:
    command = ["tapvid", str(dataset), "--predictions", str(write_predictions("left", "right"))]
    assert main([*command, "--overlay", str(tmp_path / "films")]) == 0
    assert sorted(file.name for file in (tmp_path / "films").iterdir()) == ["left.mp4", "right.mp4"]
    with av.open(str(tmp_path / "films" / "left.mp4")) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 11
    assert frames[0].shape == (320, 1024, 3)


def test_a_true_track_is_drawn_once_and_only_where_it_is_known(dataset: Path) -> None:
    """A point asked for twice, drawn by its first query; its truth is hidden in the last frame."""
    video = read_dataset(dataset)["left"]
    video.frames()[:] = 0
    tracks = np.full((2, 11, 2), 100.0)
    tracks[:, :, 0] = 20 + 16 * np.arange(11)
    occluded = np.zeros((2, 11), bool)
    occluded[:, 10] = True
    queries = Queries(np.array([[0, 100.0, 20.0], [5, 100.0, 100.0]]), tracks, occluded)
    said = Prediction(np.stack([tracks[0], tracks[1] + 80]), np.zeros((2, 11), bool), (32, 20))
    film = [frame.max(axis=2) > 100 for frame in side_by_side(Scored(video, queries, said, {}))]
    rows, columns = (round(y * 320 / 256) for y in (100, 180)), [2 * (20 + 16 * frame) for frame in range(11)]
    row, row_of_second = rows
    assert film[10][row, columns[10]]
    assert not film[10][row_of_second].any()
    assert not film[10][row, 512 + columns[10]]
    assert film[9][row, 512 + columns[9]]


def test_a_film_without_queries(dataset: Path) -> None:
    video = read_dataset(dataset)["left"]
    nothing = Queries(np.zeros((0, 3)), np.zeros((0, 11, 2)), np.zeros((0, 11), bool))
    film = list(side_by_side(Scored(video, nothing, Prediction(nothing.tracks, nothing.occluded, (32, 20)), {})))
    assert len(film) == 11


def scored(dataset: Path, name: str, shift: float) -> Scored:
    video = read_dataset(dataset)[name]
    queries = sample_queries(video, "strided")
    prediction = Prediction(queries.tracks + shift, queries.occluded, (32, 20))
    return Scored(video, queries, prediction, score(queries, prediction, "strided"))


def test_the_worst_clips_are_kept_in_order(dataset: Path) -> None:
    worst = WorstClips()
    for shift in (0, 8, 1, 3, 0.5):
        worst.see(scored(dataset, "left", shift))
    values = [clip.average_jaccard for clip in worst.clips]
    assert len(values) == CLIPS
    assert values == sorted(values)
    assert values[0] == 0.2  # sqrt(128) is within 16 only
    picture = cv2.imdecode(np.frombuffer(worst.clips[0].jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (200, 4 * 320 + 3 * 4, 3)


def test_points_are_drawn_in_the_colour_of_their_error(dataset: Path) -> None:
    """One point on a black video, in the last of whose frames it is looked at."""
    video = read_dataset(dataset)["left"]
    video.frames()[:] = 0
    tracks = np.full((1, 11, 2), 100.0)
    for shift, hidden, seen, colour in ((0, False, True, FOUND), (60, False, True, LOST), (0, True, True, FALSE)):
        occluded = np.zeros((1, 11), bool)
        occluded[0, 10] = hidden
        queries = Queries(np.array([[0, 100.0, 100.0]]), tracks, occluded)
        prediction = Prediction(tracks + shift, np.full((1, 11), not seen), (32, 20))
        picture = draw(Scored(video, queries, prediction, {"average_jaccard": 0.0}))[:, -320:]
        x, y = round((100 + shift) * 320 / 256), round((100 + shift) * 200 / 256)
        np.testing.assert_allclose(picture[y, x], colour, atol=12)  # antialiased


@pytest.mark.parametrize(("query_mode", "methods"), [("strided", 14), ("first", 11)])
def test_published_figures_are_the_paper_s(query_mode: str, methods: int) -> None:
    table = published(query_mode)
    assert len(table.rows) == methods
    assert table.url == "https://arxiv.org/abs/2407.06531"
    ours = table.rows["DecoMotion (RAFT)"]
    expected = {"strided": (0.602, 0.744, 0.872, 0.69), "first": (0.53, 0.699, 0.842, 0.69)}[query_mode]
    assert tuple(ours.values()) == pytest.approx(expected)
    assert math.isnan(table.rows["TAPIR"]["temporal_coherence"])
