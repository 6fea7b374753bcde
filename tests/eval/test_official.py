"""Equality with the official function, on recorded inputs and outputs (`recorded/README.md`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from decomo_eval.metrics import tapvid_metrics

RECORDED = dict(np.load(Path(__file__).parent / "recorded" / "tapvid_metrics.npz"))
INPUTS = {name.removeprefix("input/"): value for name, value in RECORDED.items() if name.startswith("input/")}


def recorded(query_mode: str, what: str) -> dict[str, np.ndarray]:
    start = f"{query_mode}/{what}/"
    return {name.removeprefix(start): value for name, value in RECORDED.items() if name.startswith(start)}


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_a_batch_of_videos_equals_the_official_function(query_mode: str) -> None:
    ours, official = tapvid_metrics(**INPUTS, query_mode=query_mode), recorded(query_mode, "video")
    assert set(ours) == set(official)
    for name, value in official.items():
        np.testing.assert_array_equal(ours[name], value, err_msg=name)  # nan where it has nan
    assert np.isnan(official["pts_within_1"]).tolist() == [False, True, False]


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_a_batch_of_one_equals_the_official_function(query_mode: str) -> None:
    official = recorded(query_mode, "video")
    for video in range(3):
        ours = tapvid_metrics(**{key: value[[video]] for key, value in INPUTS.items()}, query_mode=query_mode)
        for name, value in official.items():
            np.testing.assert_array_equal(ours[name], value[[video]], err_msg=name)


@pytest.mark.parametrize("query_mode", ["first", "strided"])
def test_a_batch_of_single_tracks_equals_the_official_trackwise_metrics(query_mode: str) -> None:
    """Metrics of each track are those of as many videos of one track: no second implementation."""
    single = {key: value[0][:, None] for key, value in INPUTS.items()}
    ours, official = tapvid_metrics(**single, query_mode=query_mode), recorded(query_mode, "track")
    for name, value in official.items():
        np.testing.assert_array_equal(ours[name], value[0], err_msg=name)
