"""Means over seeds, clips and clips in common."""

from __future__ import annotations

from typing import Any

import plots
import table
from harness.summary import AJ, SPLITS, TC, by_clip, by_seed, differences, means, worst


def record(clip: str, seed: int, aj: float | None, budget: str = "1m", **splits: float) -> dict[str, Any]:
    return {
        "clip": clip,
        "seed": seed,
        "time_budget": budget,
        "stages": {"train": {"steps": 100 + seed, "peak_rss_gib": 1.5}},
        "metrics": {"strided": {"average_jaccard": aj, "temporal_coherence": 0.5}},
        "splits": {"strided": {name: {"average_pts_within_thresh": value} for name, value in splits.items()}},
    }


RECORDS = [
    record("a", 0, 0.5, static=0.25),
    record("a", 1, 0.7, static=0.75),
    record("b", 0, 0.2),
    record("b", 1, None),
]


def test_seeds_are_averaged_within_a_clip_and_clips_in_a_row():
    values = by_clip(RECORDS, "strided")
    assert [round(values[clip][AJ] or 0, 6) for clip in "ab"] == [60, 20]
    average = means(values)
    assert round(average[AJ] or 0, 6) == 40
    assert average[TC] == 0.5
    static, dynamic, _ = SPLITS
    assert average[static] == 50  # of the one clip that has static points
    assert average[dynamic] is None
    assert by_seed(RECORDS, AJ, "strided") == {0: 35, 1: 70}
    assert worst(values, AJ) == ("b", 20)
    assert by_clip(RECORDS, "first")["a"][AJ] is None


def test_differences_are_over_the_clips_in_common():
    baseline = by_clip([record("a", 0, 0.4), record("c", 0, 0.9)], "strided")
    apart = differences(by_clip(RECORDS, "strided"), baseline)
    assert set(apart) == {"a"}
    assert round(means(apart)[AJ] or 0, 6) == 20
    assert worst(differences({}, baseline), AJ) is None


def test_a_row_of_the_table():
    baseline = by_clip([record("a", 0, 0.4), record("b", 0, 0.25)], "strided")
    lines = list(table.row_table({"mine": RECORDS}, "strided", baseline))
    assert lines[2] == (
        "| mine | 2 | 40.0 |  |  | 0.50 | 50.0 |  |  | b, 20.0 | 35.0 / 70.0 | 100 to 101 | 1.5 | +7.5 |  | b, -5.0 |"
    )


def test_budgets_grow_and_seeds_are_averaged():
    records = [record("a", 0, 0.6, "3m"), record("a", 0, 0.2, "90s"), record("a", 1, 0.4, "90s"), record("a", 0, None)]
    (first, second) = plots.minutes_and_values(records, AJ)
    assert (first[0], second[0]) == (1.5, 3)
    assert [round(first[1], 6), round(second[1], 6)] == [30, 60]
    figure = plots.budget_figure(records, [record("a", 0, 0.5)], (AJ, TC))
    assert len(figure.axes) == 2
