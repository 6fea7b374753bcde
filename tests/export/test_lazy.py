"""What is not asked for is not computed, and what is left out does not change the rest."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import onnxruntime

from decomo_runtime import Tracker, contract
from tiny_export import Export, random_queries

QUERIES = random_queries(7)


def nodes_run(path: Path, folder: Path, outputs: tuple[str, ...], frames: int) -> set[str]:
    """Names of the nodes that one call executes."""
    options = onnxruntime.SessionOptions()
    options.enable_profiling = True
    options.profile_file_prefix = str(folder / "profile")
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    session.run(list(outputs), {contract.QUERIES: QUERIES, contract.FRAMES: np.arange(frames)})
    events = json.loads(Path(session.end_profiling()).read_text())
    return {event["name"] for event in events if event["name"].endswith("_kernel_time")}


def test_fewer_nodes_run(fitted: Export, tmp_path: Path):
    tracking = nodes_run(fitted.path, tmp_path, contract.OUTPUTS[:2], 3)
    looking = nodes_run(fitted.path, tmp_path, contract.OUTPUTS[2:], 0)
    everything = tracking | looking
    assert len(tracking) < 0.8 * len(everything)
    assert len(looking) < 0.8 * len(everything)
    assert len(tracking & looking) < 0.2 * len(everything)


def test_what_is_not_computed_is_not_a_number(exported: Export):
    asked = {contract.QUERIES: QUERIES, contract.FRAMES: np.arange(3)}
    answers = exported.session.run(list(contract.OUTPUTS), asked)
    expected = exported.ask_file(QUERIES, np.arange(3))
    for name, given, whole in zip(contract.OUTPUTS, map(np.asarray, answers), expected, strict=True):
        assert given.shape == whole.shape
        if name in (contract.TRACKS, contract.OCCLUSION):
            np.testing.assert_array_equal(given, whole)
        else:
            assert np.isnan(given).all()


def test_the_tracker_asks_for_what_it_needs(exported: Export):
    tracker = Tracker(exported.path, threads=1)
    queries = np.clip(QUERIES, 0, 31)
    whole = exported.ask_file(queries, np.arange(8))
    np.testing.assert_allclose(tracker.track(queries).xy, whole[0], rtol=0, atol=1e-4)  # other sizes, other sums
    np.testing.assert_allclose(tracker.sample(queries).rgb, whole[2], rtol=0, atol=1e-5)
    small = tracker.track(queries, max_memory=3 * tracker.facts.bytes_per_ray)
    np.testing.assert_allclose(small.xy, whole[0], rtol=0, atol=1e-4)


def test_threads_share_one_tracker(exported: Export):
    """Tracks and appearance, asked by several threads at once, are those that one thread gets."""
    tracker = Tracker(exported.path, threads=1)
    batches = [np.clip(random_queries(1 + seed % 9, seed), 0, 31) for seed in range(24)]
    expected = [(tracker.track(batch), tracker.sample(batch)) for batch in batches]
    with ThreadPoolExecutor(4) as pool:
        tracks, seen = pool.map(tracker.track, batches), pool.map(tracker.sample, batches)
        for (of_tracks, of_seen), each, colours in zip(expected, tracks, seen, strict=True):
            np.testing.assert_array_equal(each.xy, of_tracks.xy)
            np.testing.assert_array_equal(each.occlusion, of_tracks.occlusion)
            np.testing.assert_array_equal(colours.rgb, of_seen.rgb)
            np.testing.assert_array_equal(colours.depth, of_seen.depth)
