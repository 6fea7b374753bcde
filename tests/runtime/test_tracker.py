from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from decomo_runtime import QueryError, Tracker, contract
from tiny_model import write_tiny_model

NUM_FRAMES, HEIGHT, WIDTH = 6, 40, 48
VELOCITY = np.array([1.5, -0.5], np.float32)
QUERIES = np.array([[0, 3, 4], [5, 47.5, 39.5], [2, -0.5, -0.5], [3, 10.25, 20.75]], np.float32)


def expected_xy(queries: npt.NDArray[np.float32], frames: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
    """[N, M, 2], one point and frame after the other."""
    xy = np.empty((len(queries), len(frames), 2), np.float32)
    for n, (t, *start) in enumerate(queries):
        for m, frame in enumerate(frames):
            xy[n, m] = start + (frame - t) * VELOCITY
    return xy


def test_every_frame(tracker: Tracker):
    tracks = tracker.track(QUERIES)
    frames = np.arange(NUM_FRAMES)
    np.testing.assert_array_equal(tracks.frames, frames)
    np.testing.assert_array_equal(tracks.queries, QUERIES)
    np.testing.assert_allclose(tracks.xy, expected_xy(QUERIES, frames), atol=1e-5)  # float32 at tens of pixels
    distance = np.abs(frames - QUERIES[:, :1])
    np.testing.assert_allclose(tracks.occlusion, distance / NUM_FRAMES, atol=1e-6)  # float32 below 1
    np.testing.assert_array_equal(tracks.occluded, distance > 3)  # the threshold itself, 0.5, is in sight
    dtypes = [getattr(tracks, name).dtype for name in ("xy", "occluded", "occlusion", "queries", "frames")]
    assert dtypes == [np.float32, np.bool_, np.float32, np.float32, np.int64]


@pytest.mark.parametrize("frames", [[2], [5, 0, 0, 3], range(1, 4), np.array([4, 1], np.uint8), (0,)])
def test_frames_in_the_order_given(tracker: Tracker, frames: Any):
    tracks = tracker.track(QUERIES, frames)
    np.testing.assert_array_equal(tracks.frames, list(frames))
    np.testing.assert_allclose(tracks.xy, expected_xy(QUERIES, tracks.frames), atol=1e-5)  # as above


@pytest.mark.parametrize("queries", [[], np.empty((0, 3)), QUERIES[:1], [(0, 1, 2)], QUERIES.astype(np.int32)])
@pytest.mark.parametrize("frames", [None, [], np.empty(0, np.int64), [1]])
def test_empty_and_single(tracker: Tracker, queries: Any, frames: Any):
    tracks = tracker.track(queries, frames)
    shape = (len(queries), NUM_FRAMES if frames is None else len(frames))
    assert tracks.xy.shape == (*shape, 2)
    assert tracks.occluded.shape == tracks.occlusion.shape == shape
    assert tracks.queries.shape == (shape[0], 3)
    np.testing.assert_allclose(tracks.xy, expected_xy(tracks.queries, tracks.frames), atol=1e-5)  # as above


@pytest.mark.parametrize("chunk", [1, 2, 3, 4, 100, np.int64(2)])
def test_the_answer_does_not_depend_on_the_chunk(tracker: Tracker, chunk: int):
    whole, parts = tracker.track(QUERIES), tracker.track(QUERIES, chunk=chunk)
    np.testing.assert_array_equal(parts.xy, whole.xy)
    np.testing.assert_array_equal(parts.occlusion, whole.occlusion)
    np.testing.assert_array_equal(tracker.sample(QUERIES, chunk=chunk).rgb, tracker.sample(QUERIES).rgb)


def test_the_answer_does_not_depend_on_the_other_queries(tracker: Tracker):
    whole = tracker.track(QUERIES)
    for row, query in enumerate(QUERIES):
        np.testing.assert_array_equal(tracker.track([query]).xy[0], whole.xy[row])


def counted(tracker: Tracker, monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """Fills with (queries, frames) of each call of the session."""
    asked = []
    model = tracker._models[0]
    ask = model._ask

    def counting(outputs: Any, queries: Any, frames: Any) -> Any:
        asked.append((len(queries), len(frames)))
        return ask(outputs, queries, frames)

    monkeypatch.setattr(model, "_ask", counting)
    return asked


def test_memory_bounds_the_rays_of_a_call(tracker: Tracker, monkeypatch: pytest.MonkeyPatch):
    asked = counted(tracker, monkeypatch)
    queries, ray = np.tile(QUERIES, (2, 1)), tracker.facts.bytes_per_ray
    whole = tracker.track(queries)
    assert asked == [(8, 6)]
    for memory, calls in {
        15 * ray: [(2, 6)] * 4,  # 2 queries x (1 + 6) rays is the most below 15
        7 * ray: [(1, 6)] * 8,
        4 * ray: [(1, 3)] * 16,  # not all frames at once
        2 * ray: [(1, 1)] * 48,
    }.items():
        asked.clear()
        tracks = tracker.track(queries, max_memory=memory)
        assert asked == calls
        np.testing.assert_array_equal(tracks.xy, whole.xy)
        np.testing.assert_array_equal(tracks.occlusion, whole.occlusion)


def test_memory_bounds_the_rays_that_are_rendered(write_model: Callable[..., Path], monkeypatch: pytest.MonkeyPatch):
    """Of a baked file, whose tracks need less."""
    baked = {contract.META_BYTES_PER_RAY: "1024", contract.META_BYTES_PER_RENDERED_RAY: "12288"}
    tracker = Tracker(write_model(baked), threads=1)
    asked = counted(tracker, monkeypatch)
    whole = tracker.sample(QUERIES)
    np.testing.assert_array_equal(tracker.sample(QUERIES, max_memory=2 * 12288).rgb, whole.rgb)
    assert asked == [(4, 0), (2, 0), (2, 0)]


def test_too_little_memory(tracker: Tracker):
    with pytest.raises(QueryError, match="max_memory=1000 is too little: this model needs 32768 bytes for one point"):
        tracker.track(QUERIES, max_memory=1000)
    with pytest.raises(QueryError, match="max_memory=1000 is too little: this model needs 16384 bytes for one point's"):
        tracker.sample(QUERIES, max_memory=1000)


@pytest.mark.parametrize("memory", [0, -1, 1.5, True, "1G"])
def test_bad_memory(tracker: Tracker, memory: Any):
    with pytest.raises(QueryError, match="max_memory must be a whole number of bytes, at least 1"):
        tracker.track(QUERIES, max_memory=memory)


def test_dense(tracker: Tracker):
    dense = tracker.dense(1, to=4)
    assert dense.flow.shape == (HEIGHT, WIDTH, 2)
    np.testing.assert_allclose(dense.flow, np.broadcast_to(3 * VELOCITY, dense.flow.shape), atol=1e-5)
    np.testing.assert_allclose(dense.occlusion, np.full((HEIGHT, WIDTH), 0.5), atol=1e-6)
    assert not dense.occluded.any()
    tracks = tracker.track([(1, 7, 5)], [4])
    assert dense.error is not None
    assert tracks.error is not None
    assert dense.error.shape == (HEIGHT, WIDTH)
    assert dense.error[5, 7] == pytest.approx(tracks.error[0, 0])
    with pytest.raises(QueryError, match=r"frames\[1\] is 6"):
        tracker.dense(0, to=6)


def test_stream(tracker: Tracker, monkeypatch: pytest.MonkeyPatch):
    whole = tracker.track(QUERIES)
    asked = counted(tracker, monkeypatch)
    parts = tracker.stream(iter([QUERIES[:1], QUERIES[1:]]))
    np.testing.assert_array_equal(next(parts).xy, whole.xy[:1])
    assert asked == [(1, 6)], "the next ones are not asked before they are wanted"
    np.testing.assert_array_equal(next(parts).xy, whole.xy[1:])
    pieces = list(tracker.stream(QUERIES, [0, 5], max_memory=6 * tracker.facts.bytes_per_ray))
    assert [len(piece.xy) for piece in pieces] == [2, 2]
    np.testing.assert_array_equal(np.concatenate([piece.xy for piece in pieces]), whole.xy[:, [0, 5]])


@pytest.mark.parametrize("chunk", [0, -3, 2.5, True, "4"])
def test_bad_chunk(tracker: Tracker, chunk: Any):
    with pytest.raises(QueryError, match="chunk must be a whole number of queries, at least 1"):
        tracker.track(QUERIES, chunk=chunk)


def test_bad_queries_and_frames_are_refused(tracker: Tracker):
    with pytest.raises(QueryError, match="query row 1 "):
        tracker.track([(0, 1, 1), (6, 1, 1)])
    with pytest.raises(QueryError, match="query row 0 "):
        tracker.sample([(0, 48, 1)])
    with pytest.raises(QueryError, match=r"frames\[1\] is 6"):
        tracker.track(QUERIES, [0, 6])


@pytest.mark.parametrize("count", [0, 1, 4])
def test_sample(tracker: Tracker, count: int):
    queries = QUERIES[:count]
    appearance = tracker.sample(queries)
    rgb = 1 / (1 + np.exp(-queries))
    np.testing.assert_allclose(appearance.rgb, rgb, atol=1e-6)  # float32 below 1, as all that follow
    np.testing.assert_allclose(appearance.rgb_static, rgb / 2, atol=1e-6)
    np.testing.assert_allclose(appearance.rgb_dynamic, rgb / 4, atol=1e-6)
    np.testing.assert_allclose(appearance.static_confidence, queries[:, 0] / NUM_FRAMES, atol=1e-6)
    np.testing.assert_allclose(appearance.depth, queries[:, 0] / 4, atol=1e-6)
    np.testing.assert_allclose(appearance.static_opacity, appearance.static_confidence / 2, atol=1e-6)


@pytest.mark.parametrize(
    ("share", "owned"),
    [("0.1", [0, 1, 2, 3, 4, 5]), (None, [0, 1, 2]), ("0.5", [0, 1, 2]), ("0.2", [0, 1, 2, 3, 4]), ("0.99", [0])],
)
def test_who_owns_a_point(tmp_path: Path, share: str | None, owned: list[int]):
    """Its static confidence is t / 6; a file that does not say (None) is an older one, of half. Half is the scene's."""
    size = {"num_frames": NUM_FRAMES, "height": HEIGHT, "width": WIDTH}
    path = write_tiny_model(tmp_path / "model.onnx", **size, metadata={contract.META_OBJECT_SHARE: share})
    on_object = Tracker(path).on_object([(t, 3, 4) for t in range(NUM_FRAMES)])
    assert on_object.dtype == np.bool_
    assert np.flatnonzero(on_object).tolist() == owned


def test_nobody_to_own(tracker: Tracker):
    assert tracker.on_object(np.empty((0, 3))).shape == (0,)
    with pytest.raises(QueryError, match="query row 0"):
        tracker.on_object([(0, 99, 4)])


def test_a_file_that_does_not_tell_opacity_is_opaque(tmp_path: Path):
    """As those of an earlier version."""
    path = write_tiny_model(
        tmp_path / "old.onnx",
        num_frames=NUM_FRAMES,
        height=HEIGHT,
        width=WIDTH,
        rename={", float[N] static_opacity)": ")", "static_opacity = Mul(static_confidence, half)": ""},
    )
    appearance = Tracker(path).sample(QUERIES)
    np.testing.assert_array_equal(appearance.static_opacity, 1)
    np.testing.assert_allclose(appearance.depth, QUERIES[:, 0] / 4, atol=1e-6)


def test_threads_share_one_tracker(tracker: Tracker):
    rng = np.random.default_rng(0)
    batches = [rng.uniform((0, 0, 0), (5, 47, 39), (1 + n % 7, 3)) for n in range(40)]
    batches = [np.concatenate([np.floor(batch[:, :1]), batch[:, 1:]], axis=1) for batch in batches]
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(tracker.track, batches))
    for batch, answer in zip(batches, answers, strict=True):
        np.testing.assert_array_equal(answer.xy, tracker.track(batch).xy)


def test_pickle_reopens_the_file(model_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(model_path.parent)
    tracker = Tracker(model_path.name, providers=["CPUExecutionProvider"], threads=1)
    pickled = pickle.dumps(tracker)
    assert len(pickled) < 1000  # the path, not the model
    monkeypatch.chdir("/")
    again = pickle.loads(pickled)
    assert again.facts == tracker.facts
    np.testing.assert_array_equal(again.track(QUERIES).xy, tracker.track(QUERIES).xy)


def test_repr(tracker: Tracker):
    assert repr(tracker).endswith("model.onnx': slide, 6 frames of 48x40)")
