"""The expected error in pixels: the rule by hand, and where it goes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decomo_runtime import QueryError, Tracker, Tracks, contract
from decomo_runtime.cli import main
from decomo_runtime.expected_error import (
    FARTHEST_FACTOR,
    LOWEST_SCORE,
    NEAR,
    Calibration,
    calibration,
    chance_near,
    expected_error,
)
from decomo_runtime.formats.frames import in_order
from decomotion.quality import Figures, Quality

NUM_FRAMES, HEIGHT, WIDTH = 6, 40, 48
RULE = Calibration(0.8, (0.001, 0.1, 0.5), (0.5, 2.0, 8.0), gap_power=0.5, quality_power=0.5, typical_median=0.25)
FIGURES = Figures(100, 1.0, 2.0, 3.0, 6.0, 0.1, 0.2, 0.3, 0.2)


def error(score: float, gap: int, median: float | None = None) -> float:
    return float(RULE.error(np.array([score]), np.array([gap]), median)[0])


def test_rule_by_hand():
    assert error(0.1, 1) == pytest.approx(2)
    assert error(0.1, 9) == pytest.approx(6)  # 2 * 9^0.5
    assert error(0.01, 1) == pytest.approx(1)  # in the middle of 0.5 and 2 in logarithms
    assert error(0.1, 1, 1.0) == pytest.approx(4)  # four times the typical median
    assert error(0.1, 1, 0.25) == pytest.approx(2)


def test_beyond_what_was_measured():
    assert error(0, 1) == error(LOWEST_SCORE, 1) == pytest.approx(0.5)
    assert error(1, 1) == pytest.approx(8)
    assert error(0.1, 1, 1e6) == pytest.approx(2 * FARTHEST_FACTOR)
    assert error(0.1, 1, 0) == pytest.approx(2 / FARTHEST_FACTOR)


def test_the_table_that_the_page_is_held_to():
    """`runtime/web/test/errors.test.ts` holds the page to the same."""
    table = json.loads((Path(__file__).parents[1] / "recorded" / "expected_error.json").read_text())
    rule = Calibration(**table["rule"])
    for case in table["cases"]:
        told = rule.error(np.array([case["score"]]), np.array([case["gap"]]), case["median"])[0]
        assert told == pytest.approx(case["error"], rel=1e-5, abs=1e-6), case


def test_at_the_query_there_is_none():
    assert error(0.9, 0) == 0


def test_the_chance_to_be_near():
    near = 2 * NEAR  # pixels of a frame of 512
    told = chance_near(np.array([[0, near, 4 * near, 1e9, np.inf, np.nan]], np.float32), 300, 512)
    np.testing.assert_allclose(told, [[1, calibration().share, 1 / (1 + 0.25 * 8), 0, 0, 0]], atol=1e-6)
    assert chance_near(np.array([1]), 512, 40) == chance_near(np.array([2]), 40, 1024)


def test_it_grows_with_the_score_and_with_time():
    """That of this version: sure answers are near, later ones are no nearer."""
    rule = calibration()
    assert 0.5 <= rule.share < 1
    assert rule.scores[0] == LOWEST_SCORE
    assert (np.diff(rule.scores) > 0).all()
    assert (np.diff(rule.errors) >= 0).all()
    assert rule.errors[-1] > 5 * rule.errors[0]
    assert rule.gap_power >= 0
    assert rule.quality_power >= 0
    assert len(rule.clips) > 1


def test_a_file_of_numbers_is_read_as_written(tmp_path: Path):
    whole = replace(RULE, clips=("camel", "dog"))
    whole.save(tmp_path / "numbers.json")
    assert Calibration.load(tmp_path / "numbers.json") == whole


def test_in_pixels_of_the_clip(write_model: Callable[..., Path]):
    """A clip of twice the size has errors twice as large; a fit that misses its links by more, larger ones."""
    model = Tracker(write_model(), threads=1).facts
    score, queries = np.full((1, 3), 0.1, np.float32), np.array([[2, 3, 4]], np.float32)
    small = expected_error(score, queries, [1, 2, 5], model)
    assert small.dtype == np.float32
    assert small[0, 1] == 0
    assert 0 < small[0, 0] <= small[0, 2]
    large = replace(model, height=2 * HEIGHT, width=2 * WIDTH)
    np.testing.assert_allclose(expected_error(score, queries, [1, 2, 5], large), 2 * small, rtol=1e-6)
    told = {factor: replace(FIGURES, median=factor * calibration().typical_median) for factor in (1, 2)}
    of = {factor: replace(model, quality=Quality(900, None, each, None, None, ())) for factor, each in told.items()}
    np.testing.assert_allclose(expected_error(score, queries, [1, 2, 5], of[1]), small, rtol=1e-6)
    grown = expected_error(score, queries, [1, 2, 5], of[2])
    np.testing.assert_allclose(grown, 2 ** calibration().quality_power * small, rtol=1e-6)


def test_every_answer_of_a_tracker_has_one(tracker: Tracker):
    queries = [(0, 3, 4), (5, 20, 30)]
    tracks = tracker.track(queries)
    assert tracks.error is not None
    assert tracks.error.shape == tracks.occluded.shape
    np.testing.assert_array_equal(
        tracks.error, expected_error(tracks.occlusion, tracks.queries, tracks.frames, tracker.facts)
    )
    alone = tracker.track(queries[1:], [1, 3]).error
    assert alone is not None
    np.testing.assert_array_equal(alone[0], tracks.error[1, [1, 3]])


@pytest.mark.parametrize("ending", [".npz", ".csv", ".json"])
def test_files_keep_it(tracker: Tracker, tmp_path: Path, ending: str):
    tracks = tracker.track([(0, 3, 4), (5, 20, 30)])
    path = tmp_path / f"tracks{ending}"
    tracks.save(path)
    loaded = Tracks.load(path)
    assert loaded.error is not None
    assert loaded.error.dtype == np.float32
    np.testing.assert_allclose(loaded.error, tracks.error, atol=1e-4)


@pytest.mark.parametrize("ending", [".npz", ".csv", ".json"])
def test_files_without_it(tracker: Tracker, tmp_path: Path, ending: str):
    path = tmp_path / f"tracks{ending}"
    replace(tracker.track([(0, 3, 4)]), error=None).save(path)
    assert "error" not in path.read_text(encoding="latin-1")
    tracks = Tracks.load(path)
    assert tracks.error is None
    with pytest.raises(QueryError, match="do not say how far off they may be"):
        tracks.within(2)


def test_a_page_s_points_of_which_some_have_none(tracker: Tracker, tmp_path: Path):
    path = tmp_path / "points.json"
    tracker.track([(0, 3, 4), (5, 20, 30)]).save(path)
    content = json.loads(path.read_text())
    del content["points"][0]["error"]
    path.write_text(json.dumps(content))
    assert Tracks.load(path).error is None


def test_answers_that_may_be_farther_off_are_marked_hidden(tracker: Tracker):
    tracks = tracker.track([(0, 3, 4), (5, 20, 30)])
    assert tracks.error is not None
    limit = float(np.median(tracks.error))
    within = tracks.within(limit)
    np.testing.assert_array_equal(within.occluded, tracks.occluded | (tracks.error > limit))
    assert (within.occluded & ~tracks.occluded).any()
    assert not within.occluded[0, 0]  # the query itself
    np.testing.assert_array_equal(within.xy, tracks.xy)
    near = replace(tracks, error=np.full_like(tracks.error, 0.5))
    assert near.occluded.any()
    np.testing.assert_array_equal(near.within(limit).occluded, tracks.occluded)  # what is hidden stays so


def test_an_answer_whose_error_is_no_number_is_marked_hidden(tracker: Tracker):
    tracks = tracker.track([(0, 3, 4)])
    assert tracks.error is not None
    error = np.zeros_like(tracks.error)
    error[0, 1] = np.nan
    within = replace(tracks, error=error, occluded=np.zeros_like(tracks.occluded)).within(4)
    assert within.occluded[0].tolist() == [number == 1 for number in range(len(tracks.frames))]


def test_tools_that_take_frames_in_order_get_it_in_order(tracker: Tracker):
    tracks = tracker.track([(0, 3, 4), (5, 20, 30)], [4, 1, 4, 2])
    assert tracks.error is not None
    np.testing.assert_array_equal(in_order(tracks).error, tracks.error[:, [1, 3, 0]])


@pytest.mark.parametrize("limit", [0, -1, float("nan")])
def test_no_limit(tracker: Tracker, limit: float):
    with pytest.raises(QueryError, match="give one above 0"):
        tracker.track([(0, 3, 4)]).within(limit)


def test_command(write_model: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """The tiny model's score is |dt| / 6, hidden above 0.5: of frames 0 to 5 the last two."""
    model = write_model({contract.META_OCCLUSION_THRESHOLD: "0.6"})
    limit = float(expected_error(np.array([[2 / 6]], np.float32), np.zeros((1, 3)), [2], Tracker(model).facts)[0, 0])
    out = tmp_path / "tracks.npz"
    asked = [str(model), "--point", "0,3,4", "--out", str(out), "--max-error", f"{limit + 0.001}"]
    assert main(asked) == 0
    assert Tracks.load(out).occluded.tolist() == [[False, False, False, True, True, True]]
    assert "33% occluded, 17% marked hidden for their error, " in capsys.readouterr().out


@pytest.mark.parametrize("limit", ["0", "-2", "nan"])
def test_command_refuses_no_limit(model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], limit: str):
    asked = [str(model_path), "--point", "0,3,4", "--out", str(tmp_path / "a.npz"), "--max-error", limit]
    assert main(asked) == 2
    assert "give one above 0" in capsys.readouterr().err
    assert not (tmp_path / "a.npz").exists()
