"""What is not asked for is not computed, and what is left out does not change the rest."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnxruntime

from decomo_runtime import Tracker, contract
from tiny_export import Export, random_queries

QUERIES = random_queries(7)


def nodes_run(path: Path, folder: Path, outputs: tuple[str, ...], frames: int, appearance: bool) -> int:
    """Number of nodes that one call executes."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.enable_profiling = True
    options.profile_file_prefix = str(folder / "profile")
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    asked = {contract.QUERIES: QUERIES, contract.FRAMES: np.arange(frames), contract.APPEARANCE: np.array(appearance)}
    session.run(list(outputs), asked)
    events = json.loads(Path(session.end_profiling()).read_text())
    return sum(event["name"].endswith("_kernel_time") for event in events if event.get("cat") == "Node")


def test_fewer_nodes_run(fitted: Export, tmp_path: Path):
    tracks, colours = (contract.TRACKS, contract.OCCLUSION), (contract.RGB,)
    everything = nodes_run(fitted.path, tmp_path, contract.OUTPUTS, 3, True)
    only_tracks = nodes_run(fitted.path, tmp_path, tracks, 3, False)
    only_colours = nodes_run(fitted.path, tmp_path, colours, 0, True)
    assert only_tracks < 0.8 * everything
    assert only_colours < 0.8 * everything
    assert only_tracks + only_colours < 1.2 * everything


def test_what_is_not_asked_for_is_zero_and_the_rest_the_same(exported: Export):
    whole = exported.ask_file(QUERIES, np.arange(3))
    asked = {contract.QUERIES: QUERIES, contract.FRAMES: np.arange(3), contract.APPEARANCE: np.array(False)}
    part = [np.asarray(value) for value in exported.session.run(list(contract.OUTPUTS), asked)]
    for name, given, expected in zip(contract.OUTPUTS, part, whole, strict=True):
        assert given.shape == expected.shape
        if name in (contract.TRACKS, contract.OCCLUSION):
            np.testing.assert_array_equal(given, expected)
        else:
            assert not given.any()


def test_the_tracker_asks_for_what_it_needs(exported: Export):
    tracker = Tracker(exported.path, threads=1)
    queries = np.clip(QUERIES, 0, 31)
    whole = exported.ask_file(queries, np.arange(8))
    np.testing.assert_allclose(tracker.track(queries).xy, whole[0], rtol=0, atol=1e-4)  # other sizes, other sums
    np.testing.assert_allclose(tracker.sample(queries).rgb, whole[2], rtol=0, atol=1e-5)
    small = tracker.track(queries, max_memory=3 * tracker.facts.bytes_per_ray)
    np.testing.assert_allclose(small.xy, whole[0], rtol=0, atol=1e-4)
