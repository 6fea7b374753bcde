"""Tracks by flow alone, from a flow that is exact."""

from __future__ import annotations

import numpy as np
import pytest

from decomo_eval import baselines as module
from decomo_eval.baselines import METHODS, Fields, FlowBaseline, direct, linked, track
from decomo_eval.dataset import Video
from decomo_eval.errors import EvalError
from decomo_eval.names import BASELINES, FLOWS
from decomo_eval.tapvid import Queries, pixels_to_raster
from decomotion.config import load
from decomotion.data.flow.config import ESTIMATORS

FRAMES, HEIGHT, WIDTH = 6, 20, 30
VIDEO = np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8)
VIDEO[:, 0, 0, 0] = np.arange(FRAMES)
"""Its first pixel is the frame's number, so that an estimator knows which frames it is given."""
DATA = load("cpu", overrides=("data.flow.intervals=[1,2]",)).data


def pan(first: np.ndarray, second: np.ndarray, pair: tuple[int, int]) -> np.ndarray:
    """Everything moves by (2, 1) pixels a frame; the field's raster is half the frames'."""
    gap = int(second[0, 0, 0]) - int(first[0, 0, 0])
    return np.broadcast_to(np.array([1.0, 0.5], np.float32) * gap, (HEIGHT // 2, WIDTH // 2, 2))


def true_tracks(points: np.ndarray) -> np.ndarray:
    """[N, T, 2] of queries (t, x, y)."""
    return points[:, None, 1:] + (np.arange(FRAMES)[None, :, None] - points[:, :1, None]) * [2.0, 1.0]


@pytest.mark.parametrize("method", METHODS)
def test_exact_flow_gives_exact_tracks_on_the_benchmark_s_raster(method: str):
    points = np.array([[0, 3.0, 4.0], [2, 10.0, 6.0], [2, 8.0, 7.0], [5, 20.0, 15.0], [0, 25.0, 5.0]])
    xy = true_tracks(points)
    raster = pixels_to_raster(points[:, 1:], WIDTH, HEIGHT)
    asked = np.column_stack([points[:, 0], raster[:, ::-1]])
    tracks = pixels_to_raster(xy, WIDTH, HEIGHT)
    queries = Queries(asked, tracks, np.zeros(tracks.shape[:2], bool))
    prediction = track(method, queries, Fields(VIDEO, pan), DATA)
    np.testing.assert_allclose(prediction.tracks, tracks, atol=1e-3)  # float32 and float16
    outside = (xy[..., 0] > WIDTH - 0.5) | (xy[..., 1] > HEIGHT - 0.5)
    assert outside.any()
    np.testing.assert_array_equal(prediction.occluded, outside)
    assert prediction.size == (WIDTH, HEIGHT)


class Broken:
    """Still, but from frame 2 on flow forward and backward disagree by `error` pixels at one crossing, 2 to 3."""

    def __init__(self, error: float) -> None:
        self.error = error

    def __call__(self, first: np.ndarray, second: np.ndarray, pair: tuple[int, int]) -> np.ndarray:
        field = np.zeros((256, 256, 2), np.float32)
        if (int(first[0, 0, 0]), int(second[0, 0, 0])) == (2, 3):
            field[..., 0] = self.error
        return field


ASKED = np.array([[0, 100.0, 100.0]], np.float32)


def test_chain_tracks_stay_hidden_and_direct_ones_return():
    broken = Fields(VIDEO, Broken(1.2))
    xy, hidden = linked(ASKED, broken, (1,), 1.0, FRAMES)
    assert hidden[0].tolist() == [False] * 3 + [True] * 3
    np.testing.assert_allclose(xy[0, :, 0], [100, 100, 100, 101.2, 101.2, 101.2], atol=1e-3)
    assert not linked(ASKED, Fields(VIDEO, Broken(0.9)), (1,), 1.0, FRAMES)[1].any()
    at_two = ASKED + np.array([2, 0, 0], np.float32)
    assert not direct(at_two, broken, 1.5)[1].any()
    assert direct(at_two, Fields(VIDEO, Broken(1.6)), 1.5)[1][0].tolist() == [False] * 3 + [True, False, False]


def test_links_go_round_a_broken_hop():
    _, hidden = linked(ASKED, Fields(VIDEO, Broken(5.0)), (1, 2), 1.5, FRAMES)
    assert hidden[0].tolist() == [False] * 6


def test_a_baseline_tracks_a_sliding_texture_with_dis():
    """A whole-pixel shift, wrapped; points far from the border."""
    rng = np.random.default_rng(0)
    texture = np.kron(rng.integers(0, 256, (16, 16, 3)), np.ones((6, 6, 1))).astype(np.uint8)
    frames = np.stack([np.roll(texture, 2 * frame, axis=1) for frame in range(4)])
    points = np.array([[40.0 + 2 * frame, 30] for frame in range(4)])
    true = pixels_to_raster(points, 96, 96)[None]
    video = Video("texture", frames, 96, 96, true / 256, np.zeros((1, 4), bool))
    queries = Queries(np.array([[0, *true[0, 0, ::-1]]]), true, video.occluded)
    for method in METHODS:
        prediction = FlowBaseline(method)(video, queries)
        assert np.abs(prediction.tracks - true).max() < 1  # raster pixels; DIS is good to a fraction of one
        assert not prediction.occluded.any()
        assert prediction.size == (96, 96)


def test_names_are_those_of_the_configuration_and_unknown_ones_are_refused():
    assert tuple(ESTIMATORS) == FLOWS
    assert tuple(METHODS) == BASELINES
    assert FlowBaseline("multi").name == "multi-dis"
    with pytest.raises(EvalError, match="no baseline chained; choose of chain, direct, multi"):
        FlowBaseline("chained")
    with pytest.raises(EvalError, match="no flow raft"):
        FlowBaseline("chain", "raft")
    with pytest.raises(EvalError, match="dis has no weights"):
        FlowBaseline("chain", "dis", "weights.pth")


def test_no_queries():
    nothing = np.zeros((0, 3), np.float32)
    fields = Fields(VIDEO, pan)
    for xy, hidden in (linked(nothing, fields, (1,), 1.0, FRAMES), direct(nothing, fields, 1.5)):
        assert xy.shape == (0, FRAMES, 2)
        assert hidden.shape == (0, FRAMES)


def test_what_is_farther_than_the_longest_gap_is_hidden():
    _, hidden = linked(np.array([[1, 3.0, 4.0]], np.float32), Fields(VIDEO, pan), (1,), 1.5, max_gap=2)
    assert hidden[0].tolist() == [False] * 4 + [True] * 2


def test_a_video_of_one_frame_is_named():
    video = Video("photo", VIDEO[:1], HEIGHT, WIDTH, np.full((1, 1, 2), 0.5), np.zeros((1, 1), bool))
    queries = Queries(np.array([[0, 128.0, 128.0]]), video.points * 256, video.occluded)
    with pytest.raises(EvalError, match="video photo has one frame and flow needs two"):
        FlowBaseline("chain")(video, queries)


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_flow_runs_where_a_fit_would(device: str, monkeypatch: pytest.MonkeyPatch):
    devices = []
    monkeypatch.setattr("torch.cuda.is_available", lambda: device == "cuda")
    monkeypatch.setattr("decomotion.data.flow.build_flow", lambda _, device: devices.append(device))
    FlowBaseline("chain", "raft-small", "weights.pth")
    assert devices == [device]


def test_fields_are_kept_up_to_a_limit(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "KEPT_BYTES", 2 * (HEIGHT // 2) * (WIDTH // 2) * 2 * 2)  # two, float16
    calls = []
    fields = Fields(VIDEO, lambda *asked: calls.append(asked[2]) or pan(*asked))
    for _ in range(2):
        assert [fields(0, target)[0, 0, 0] for target in (1, 2, 3)] == [1.0, 2.0, 3.0]
    assert calls == [(0, 1), (0, 2), (0, 3), (0, 3)]


def test_fields_are_computed_once():
    calls = []
    fields = Fields(VIDEO, lambda *asked: calls.append(1) or pan(*asked))
    for _ in range(2):
        assert fields(0, 3)[0, 0].tolist() == [3.0, 1.5]
    assert len(calls) == 1


class OffBy:
    """What moves forward by nothing moves back by so many pixels, in fields of 128x96: two of its pixels are four
    units of a frame whose longer side is 256."""

    def __init__(self, pixels: float) -> None:
        self.pixels = pixels

    def __call__(self, first: np.ndarray, second: np.ndarray, pair: tuple[int, int]) -> np.ndarray:
        back = int(second[0, 0, 0]) < int(first[0, 0, 0])
        return np.full((96, 128, 2), [self.pixels * back, 0], np.float32)


@pytest.mark.parametrize(("method", "limit"), [("chain", 1.0), ("direct", 1.5), ("multi", None)])
def test_cycle_errors_are_those_of_frames_of_256_pixels(method: str, limit: float | None):
    limit = DATA.pool.cycle_threshold if limit is None else limit
    asked = np.array([[0, 50, 40]], np.float32)
    for units, hidden in ((limit - 0.1, False), (limit + 0.1, True)):
        found = METHODS[method](asked, Fields(VIDEO, OffBy(units / 2)), DATA)[1][0]
        assert found.tolist() == [False] + [hidden] * (FRAMES - 1)


def test_multi_goes_no_farther_than_a_fit_s_supervision():
    data = load("cpu", overrides=("data.flow.intervals=[1,2]", "data.pool.max_gap=3")).data
    asked = np.array([[0, 50, 40]], np.float32)
    assert METHODS["multi"](asked, Fields(VIDEO, OffBy(0)), data)[1][0].tolist() == [False] * 4 + [True] * 2
    assert not METHODS["chain"](asked, Fields(VIDEO, OffBy(0)), data)[1].any()
